"""The LMF driver against a stand-in with LMF's names and rules; every test also checks the rules."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.trackers.lmf import MEASURING_S, LmfTracker, visible_trackers
from drivers.trackers.lmf_objects import ErrorLaw, LmfMissing, load_lmf
from drivers.trackers.lmf_settings import LmfSettings
from drivers.trackers.protocol import (
    Halted,
    NotReady,
    Preparation,
    TargetLost,
    Track,
    TrackerError,
    TrackerLinkLost,
    TrackerRefused,
    TrackerTimeout,
    Unstable,
    WrongTarget,
    stream_of,
)
from tests.drivers.trackers.fake_lmf import E, LmfException, Scene
from tests.sure import sure
from tests.waiting import until

LEFT = np.array([3.0, 0.4, -0.2])
RIGHT = np.array([3.0, -0.7, 0.1])
Make = Callable[..., LmfTracker]
LONG_S = 10.0
SHORT_S = 0.15


@pytest.fixture
def scene() -> Iterator[Scene]:
    scene = Scene(targets={"left": LEFT, "right": RIGHT}, initialised=True)
    yield scene
    scene.release.set()
    assert scene.violations == []


@pytest.fixture
def tracker(scene: Scene) -> Iterator[Make]:
    """``tracker(preparation, **settings)``: a connected tracker, disconnected at the end."""
    made = []

    def make(preparation: Preparation | None = None, **settings: Any) -> LmfTracker:
        use = LmfSettings(**({"address": "192.168.0.1"} | settings))
        driver = LmfTracker(use, preparation or Preparation(), load=lambda library: scene.lmf())
        made.append(driver)
        driver.connect()
        return driver

    yield make
    scene.release.set()
    for driver in made:
        driver.disconnect()


@pytest.fixture
def driver(tracker: Make) -> LmfTracker:
    return tracker()


def tree(scene: Scene) -> Any:
    """LMF's own object of the tracker that was connected last."""
    return scene.persistent["tracker"]


# -- loading ----------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform == "win32", reason="what it says elsewhere")
def test_other_systems_than_windows_are_refused() -> None:
    with pytest.raises(LmfMissing, match=r"LMF needs Windows and the extra cellapp\[lmf\]; this is linux"):
        load_lmf("LMF.Tracker.Connection")
    with pytest.raises(LmfMissing, match="tracker-bridge"):
        LmfTracker(LmfSettings(address="192.168.0.1")).connect()
    assert "LMF needs Windows" in visible_trackers()


def test_windows_without_pythonnet_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setitem(sys.modules, "clr", None)
    with pytest.raises(LmfMissing, match=r"pip install cellapp\[lmf\]"):
        load_lmf("LMF.Tracker.Connection")


def test_nothing_of_pythonnet_is_loaded_with_the_driver() -> None:
    assert "clr" not in sys.modules
    assert "pythonnet" not in sys.modules


@pytest.mark.parametrize("address", ["AT960LRSimulator", "at960simulator#506432", "AT403Simulator", "AT960MRSIMULATOR"])
def test_simulators_of_lmf(tracker: Make, scene: Scene, address: str) -> None:
    driver = tracker(address=address)
    assert driver.identify().model == "AT960-LR (simulated by LMF)"
    assert driver.measure(LEFT, 1.0).p_M == pytest.approx(LEFT)


# -- connecting and settings ------------------------------------------------------------------------------------------


def test_settings_are_applied_again_after_every_connect(tracker: Make, scene: Scene) -> None:
    driver = tracker(Preparation(reflector="RedRingReflector15", accuracy="precise"), power_lock=True)
    for _ in range(2):
        it = tree(scene)
        units = it.Settings.Units
        assert [str(v) for v in (it.Settings.CoordinateType, units.LengthUnit, units.AngleUnit)] == [
            "Cartesian",
            "Meter",
            "Radian",
        ]
        assert [str(v) for v in (units.TemperatureUnit, units.PressureUnit)] == ["Celsius", "HPascal"]
        profile = it.Measurement.Profiles.Selected
        assert type(profile).__name__ == "StationaryMeasurementProfile"
        assert (str(profile.Accuracy.Value), profile.TwoFace.Value) == ("Precise", False)
        assert it.Targets.PreSelected.Name == "RRR 1.5in"
        assert it.PowerLock.UsePowerLock.Value is True
        assert it.MeteoStation.Source.Value == E["EMeteoSource"].LiveMeteo
        assert "PositionTo" not in scene.calls
        assert "Initialize" not in scene.calls
        before = it
        driver.disconnect()
        driver.connect()
        assert tree(scene) is not before


def test_accuracy_as_a_number(tracker: Make, scene: Scene) -> None:
    """Programs disagree whether this value object holds the enumeration or its number."""
    scene.number_accuracy, scene.bool_selectable = True, False
    tracker(Preparation(accuracy="precise", reflector="rrr"))
    assert tree(scene).Measurement.Profiles.Selected.Accuracy.Value == int(E["EAccuracy"].Precise)


def test_settings_that_lmf_keeps_are_set_too(tracker: Make, scene: Scene) -> None:
    scene.persistent.update(gravity=True, meteo=E["EMeteoSource"].ManualMeteo, busy=True)
    tracker()
    assert tree(scene).InclinationSensor.InclinedToGravity.Value is False
    assert tree(scene).MeteoStation.Source.Value == E["EMeteoSource"].LiveMeteo
    assert scene.calls.index("StopMeasurement") < scene.calls.index("Select profile")


@pytest.mark.parametrize(
    ("wanted", "chosen"),
    [("BRR 1.5in", "BRR 1.5in"), ("breakresistantreflector15", "BRR 1.5in"), ("Red Ring", "RRR 1.5in")],
)
def test_reflectors_by_class_name_or_part(tracker: Make, scene: Scene, wanted: str, chosen: str) -> None:
    driver = tracker(Preparation(reflector=wanted))
    assert driver.measure(LEFT, 1.0).reflector == chosen


@pytest.mark.parametrize(("wanted", "which"), [("1.5in", "several"), ("0.5in", "none"), ("T-Mac", "none")])
def test_a_reflector_that_is_not_one(tracker: Make, wanted: str, which: str) -> None:
    with pytest.raises(ValueError, match=rf"{which} matches '{wanted}'; they are 'RRR 1.5in' \(RedRingReflector15\),"):
        tracker(Preparation(reflector=wanted))


def test_a_setting_that_does_not_take(tracker: Make, scene: Scene) -> None:
    scene.ignored_settings = {"TwoFace"}
    with pytest.raises(TrackerError, match="TwoFace does not take False; it stays at True"):
        tracker()
    scene.ignored_settings = {"reflector"}
    with pytest.raises(TrackerError, match="did not take the reflector"):
        tracker(Preparation(reflector="RedRingReflector15"))
    assert scene.connected == []  # after a failed connect the tracker is released


def test_air_by_hand(tracker: Make, scene: Scene) -> None:
    driver = tracker(Preparation(temperature_c=23.0, pressure_hpa=998.0, humidity_percent=35.0))
    point = driver.measure(LEFT, 1.0)
    assert (point.temperature_c, point.pressure_hpa, point.humidity_percent) == (23.0, 998.0, 35.0)
    with pytest.raises(ValueError, match="together"):
        driver.prepare(Preparation(temperature_c=23.0))
    with pytest.raises(TrackerError, match=r"settings failed: ManualTemperature: 70.0 is not in"):
        driver.prepare(Preparation(temperature_c=70.0, pressure_hpa=998.0, humidity_percent=35.0))


def test_in_use_and_out_of_reach(tracker: Make, scene: Scene) -> None:
    tracker(address="AT960Simulator")
    with pytest.raises(TrackerRefused, match=r"holds it: Controller Already In Use \(LMF 10011\)"):
        tracker(address="AT960Simulator")
    tracker(address="AT960Simulator#2")
    with pytest.raises(TrackerLinkLost, match=r"no connection: Not reachable: No tracker at 10.0.0.9.: Check"):
        tracker(address="10.0.0.9")


def test_another_tracker_is_refused(tracker: Make, scene: Scene) -> None:
    with pytest.raises(TrackerError, match="serial number is 750123, the settings name 111"):
        tracker(serial="111")
    assert scene.connected == []
    identity = tracker(serial="750123").identify()
    assert (identity.model, identity.serial, identity.software) == ("AT960-LR", "750123", "firmware 2.3.0.1")


def test_another_lmf_is_named(driver: LmfTracker, scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(type(tree(scene).Measurement), "MeasureStationary")
    with pytest.raises(TrackerError, match=r"lacks what the driver needs: .*MeasureStationary"):
        driver.measure(LEFT, 1.0)


# -- readiness --------------------------------------------------------------------------------------------------------


def test_every_precondition_is_named(tracker: Make, scene: Scene) -> None:
    scene.initialised, scene.quick_release, scene.warmed_up = False, False, False
    driver = tracker()
    assert driver.unmet() == [
        "its laser is warming up",
        "its quick release is open: close it",
        "Tracker not initialized: Initialize it. (LMF 300)",
    ]
    with pytest.raises(NotReady, match=r"warming up; its quick release is open.*not initialized"):
        driver.measure(LEFT, 1.0)
    with pytest.raises(NotReady, match="warming up"):
        driver.prepare(Preparation())
    assert "Initialize" not in scene.calls  # with a cold laser it would be for nothing
    scene.warmed_up, scene.laser_on = True, False
    assert driver.unmet()[0] == "its laser is off: switch it on and let it warm up"


def test_level(tracker: Make, scene: Scene) -> None:
    driver = tracker(address="AT960Simulator", gravity=True)
    driver.prepare(Preparation())
    assert tree(scene).InclinationSensor.InclinedToGravity.Value is True


def test_a_tracker_without_level(tracker: Make, scene: Scene) -> None:
    scene.level = False
    with pytest.raises(ValueError, match="has no level"):
        tracker(address="AT960Simulator", gravity=True).prepare(Preparation())


def test_notices(driver: LmfTracker, scene: Scene) -> None:
    assert driver.notices() == []
    scene.compatible, scene.air_sensor = False, False
    tree(scene).Compensations.Selected = None
    assert driver.notices() == [
        "its firmware is 2.3.0.1, this LMF was made for 2.3",
        "no compensation is selected",
        "its air sensor is not connected",
    ]


# -- measuring --------------------------------------------------------------------------------------------------------


def test_averaging_time_set_by_the_caller(tracker: Make, scene: Scene) -> None:
    driver = tracker(stationary="time")
    assert driver.measure(LEFT, 2.5).averaging_s == 2.5
    profile = tree(scene).Measurement.Profiles.Selected
    assert type(profile).__name__ == "CustomStationaryMeasurementProfile"
    assert profile.Time.Value == 2500.0  # in the unit that LMF reports
    driver.measure(LEFT, 0.5)
    assert profile.Time.Value == 500.0
    with pytest.raises(TrackerError, match=r"pointing and searching failed: : 10\.0 is not in"):
        driver.measure(LEFT, 0.01)


@given(p=st.tuples(*[st.floats(-8.0, 8.0)] * 3).filter(lambda p: math.hypot(*p) > 0.5))
def test_the_law_is_turned_into_cartesian(p: tuple[float, float, float]) -> None:
    p_M = np.array(p)
    law = ErrorLaw(transverse=(15e-6, 6e-6), range=(10e-6, 0.3e-6))
    covariance = law.covariance(p_M)
    distance = np.linalg.norm(p_M)
    beam = p_M / distance
    across, along = 0.5 * (15e-6 + 6e-6 * distance), 0.5 * (10e-6 + 0.3e-6 * distance)
    assert covariance == pytest.approx(covariance.T)
    assert math.sqrt(beam @ covariance @ beam) == pytest.approx(along)
    assert np.sqrt(np.linalg.eigvalsh(covariance)) == pytest.approx([along, across, across])


def test_a_shaking_target(driver: LmfTracker, scene: Scene) -> None:
    calm = driver.measure(LEFT, 1.0)
    assert calm.covariance_M == pytest.approx(ErrorLaw().covariance(LEFT))
    scene.precision_m = 80e-6
    shaken = driver.measure(LEFT, 1.0)
    assert np.trace(shaken.covariance_M) == pytest.approx((80e-6) ** 2)
    scene.precision_m = 150e-6
    with pytest.raises(Unstable, match="precision 150 µm"):
        driver.measure(LEFT, 1.0)


def test_left_in_face_2_it_turns_back(driver: LmfTracker, scene: Scene) -> None:
    tree(scene).face2 = True
    driver.measure(LEFT, 1.0)
    assert tree(scene).face2 is False


def test_the_other_arms_smr(driver: LmfTracker, scene: Scene) -> None:
    scene.search_m = 2.0
    scene.hidden.add("left")
    with pytest.raises(WrongTarget, match=r"an SMR 11\d\d mm from where"):
        driver.measure(LEFT, 1.0)


def test_a_probe_in_the_beam(driver: LmfTracker, scene: Scene) -> None:
    scene.targets = {"T-Mac": LEFT}
    with pytest.raises(WrongTarget, match=r"locked a 'T-Mac' where a 'BRR 1\.5in'"):
        driver.measure(LEFT, 1.0)


TURNED = np.array([0.5, -0.5, 0.1, 0.7])


def with_probe(scene: Scene, quaternion: np.ndarray = TURNED) -> None:
    scene.targets["T-Mac"] = scene.targets.pop("left")
    scene.probes["T-Mac"] = quaternion


def test_the_rotation_of_a_probe_comes_with_its_point(tracker: Make, scene: Scene) -> None:
    with_probe(scene)
    device = tracker(Preparation("RedRingReflector15"), probes=True)
    point = device.measure(LEFT, 1.0)
    np.testing.assert_allclose(point.p_M, LEFT)
    np.testing.assert_allclose(sure(point.quaternion_M), TURNED)
    assert point.sigma_rad == pytest.approx(0.5 * math.radians(0.01))
    assert tree(scene).Settings.RotationType == E["ERotationType"].Quaternion
    smr = device.measure(RIGHT, 1.0)
    assert (smr.quaternion_M, smr.sigma_rad) == (None, None)


def test_a_rotation_in_another_form_is_refused(tracker: Make, scene: Scene) -> None:
    with_probe(scene)
    device = tracker(Preparation(), probes=True)
    tree(scene).Settings.RotationType = E["ERotationType"].RotationAngles
    with pytest.raises(TrackerError, match="rotation comes as RotationAngles; another program changed that"):
        device.measure(LEFT, 1.0)


@pytest.mark.parametrize("quaternion", [np.array([30.0, 10.0, 0.0, 5.0]), np.full(4, np.nan)])
def test_a_rotation_that_is_no_unit_quaternion_is_refused(tracker: Make, scene: Scene, quaternion: np.ndarray) -> None:
    with_probe(scene, quaternion)
    with pytest.raises(TrackerError, match="is a quaternion of length"):
        tracker(Preparation(), probes=True).measure(LEFT, 1.0)


def test_another_lmf_whose_rotation_has_other_members_says_which(tracker: Make, scene: Scene) -> None:
    with_probe(scene)
    scene.rotation_member = "Parameter"
    with pytest.raises(TrackerError, match="has no Value0, Value1, Value2, Value3 in this LMF, only Parameter0, "):
        tracker(Preparation(), probes=True).measure(LEFT, 1.0)


def test_the_beam_breaks(driver: LmfTracker, scene: Scene) -> None:
    scene.beam_breaks = True
    with pytest.raises(TargetLost, match="Measurement aborted"):
        driver.measure(LEFT, 1.0)
    scene.beam_breaks = False
    scene.throws["MeasureStationary"] = LmfException(840702, "Target lost", "Interferometer not locked.")
    with pytest.raises(TargetLost, match="Interferometer not locked"):
        driver.measure(LEFT, 1.0)
    scene.throws["MeasureStationary"] = LmfException(55, "Something else")
    with pytest.raises(TrackerError, match=r"measuring failed: Something else \(LMF 55\)") as caught:
        driver.measure(LEFT, 1.0)
    assert type(caught.value) is TrackerError
    assert driver.measure(LEFT, 1.0).p_M == pytest.approx(LEFT)


def test_warnings_of_lmf_come_with_the_point(driver: LmfTracker, scene: Scene) -> None:
    driver.measure(LEFT, 1.0)
    tree(scene).warn("Quick release opened")
    scene.flags = "AccuracyError"
    scene.air_sensor = False
    quality = driver.measure(LEFT, 1.0).quality
    assert "Quick release opened: Something is not well.: Look at it. (LMF 4711)" in quality
    assert {"AccuracyError", "its air sensor is not connected"} <= set(quality)
    scene.flags, scene.air_sensor, scene.temperature_c = "AllOk", True, 200.0
    point = driver.measure(LEFT, 1.0)
    assert point.temperature_c is None
    assert "temperature applied to the point reads 200, which is not plausible" in point.quality


# -- waiting ----------------------------------------------------------------------------------------------------------


def test_time_limits_are_leicas() -> None:
    assert dict(MEASURING_S) == {"fast": 2.0, "standard": 12.0, "precise": 12.0}


def test_a_measurement_that_never_ends(driver: LmfTracker, scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    scene.hanging = {"MeasureStationary"}
    with monkeypatch.context() as shorter:
        shorter.setattr("drivers.trackers.lmf.MEASURING_S", {"standard": SHORT_S})
        with pytest.raises(TrackerTimeout, match=r"measuring took longer than 0.15 s"):
            driver.measure(LEFT, 1.0)
    with pytest.raises(TrackerLinkLost, match="has not returned from measuring"):
        driver.measure(RIGHT, 1.0)
    scene.hanging = set()
    scene.release.set()
    assert driver.measure(RIGHT, 1.0).p_M == pytest.approx(RIGHT)  # and not the late one of the left


def test_halt(driver: LmfTracker, scene: Scene) -> None:
    driver.halt()
    assert driver.unmet() == []  # harmless without a running measurement
    assert driver.measure(LEFT, 1.0).p_M == pytest.approx(LEFT)
    scene.hanging = {"MeasureStationary"}

    def halt() -> None:
        scene.entered.wait(LONG_S)
        driver.halt()

    thread = threading.Thread(target=halt)
    thread.start()
    with pytest.raises(Halted):
        driver.measure(LEFT, 1.0)
    thread.join(LONG_S)
    scene.hanging = set()
    scene.release.set()
    assert driver.measure(RIGHT, 1.0).p_M == pytest.approx(RIGHT)


def test_the_link_breaks(driver: LmfTracker, scene: Scene) -> None:
    tree(scene).drop()
    with pytest.raises(TrackerLinkLost, match=r"connection closed: Connection lost \(LMF 1\); connect again"):
        driver.measure(LEFT, 1.0)
    driver.connect()
    assert driver.measure(LEFT, 1.0).p_M == pytest.approx(LEFT)
    driver.disconnect()
    driver.disconnect()
    with pytest.raises(TrackerLinkLost, match="not connected"):
        driver.unmet()
    assert scene.connected == []


# -- whether it answers now --------------------------------------------------------------------------------------------


def test_it_answers_now(driver: LmfTracker, scene: Scene) -> None:
    scene.laser_on = scene.quick_release = False  # what measuring lacks does not matter
    driver.confirm(LONG_S)
    assert driver.data_age_s() < LONG_S
    tree(scene).drop()
    with pytest.raises(TrackerLinkLost, match="connection closed"):
        driver.confirm(LONG_S)
    assert driver.data_age_s() == math.inf


def test_an_lmf_that_hangs_does_not_answer(driver: LmfTracker, scene: Scene) -> None:
    scene.hanging = {"QuickRelease"}
    with pytest.raises(TrackerLinkLost, match=r"LMF did not answer within 0.15 s"):
        driver.confirm(SHORT_S)
    began_s = time.monotonic()
    with pytest.raises(TrackerLinkLost, match="has not returned from confirming"):
        driver.confirm(LONG_S)
    assert time.monotonic() - began_s < 0.5 * LONG_S, "it waits for nothing"
    assert driver.data_age_s() > SHORT_S
    scene.hanging = set()
    scene.release.set()
    until(lambda: driver.data_age_s() < SHORT_S, "the next data")
    driver.confirm(LONG_S)


def test_a_measurement_that_was_given_up_is_still_at_work(driver: LmfTracker, scene: Scene) -> None:
    scene.hanging = {"MeasureStationary"}

    def measure() -> None:
        with pytest.raises(Halted):
            driver.measure(LEFT, 1.0)

    measuring = threading.Thread(target=measure)
    measuring.start()
    assert scene.entered.wait(LONG_S)
    assert driver.data_age_s() == 0.0  # within Leica's time
    driver.halt()
    measuring.join(LONG_S)
    began_s = time.monotonic()
    with pytest.raises(TrackerTimeout, match="still at work on measuring, which was given up"):
        driver.confirm(LONG_S)
    assert time.monotonic() - began_s < 0.5 * LONG_S, "it waits for nothing"
    scene.hanging = set()
    scene.release.set()


def test_a_connect_that_comes_too_late_lets_go_again(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.trackers.lmf.CONNECTING_S", SHORT_S)
    scene.hanging = {"Connect"}
    driver = LmfTracker(LmfSettings(address="192.168.0.1", timeout=SHORT_S), load=lambda library: scene.lmf())
    with pytest.raises(TrackerTimeout, match="connecting took longer"):
        driver.connect()
    (thread,) = scene.threads
    scene.release.set()
    thread.join(LONG_S)
    assert not thread.is_alive()
    assert scene.calls[-1] == "Disconnect"
    assert scene.connected == []


# -- LMF's continuous measurement: packets, stamps, a beam that breaks, stationary ones after it -----------------------


@pytest.mark.parametrize(("interval_s", "rate"), [(0.001, 50), (0.004, 50), (0.1, 10)])
def test_points_come_in_packets_with_the_controllers_stamps(
    scene: Scene, driver: LmfTracker, interval_s: float, rate: int
) -> None:
    assert stream_of(driver) is driver
    seen: list[Track] = []
    lost: list[TrackerError] = []
    driver.start_track(LEFT, interval_s, lost.append, seen.append)
    profile = tree(scene).Measurement.Profiles.Selected
    assert profile.TimeSeparation.Value == pytest.approx(interval_s * 1e3)
    assert profile.PacketRate.Value == rate
    for packet in range(5):
        tree(scene).Measurement.send(20 * packet, 20)
    track = driver.end_track()
    assert lost == []
    assert [len(one.p_M) for one in seen] == [20] * 5
    np.testing.assert_allclose(np.diff(track.device_time_s), interval_s, atol=1e-6)
    np.testing.assert_allclose(track.p_M, np.repeat(LEFT[None], 100, axis=0), atol=1e-9)
    assert (track.sigma_m > 5e-6).all()
    assert (np.diff(track.arrived_s) >= 0.0).all()
    assert scene.calls.count("StopMeasurement") == 1
    assert driver.measure(LEFT, 1.0).p_M == pytest.approx(LEFT)  # the stationary profile is back


def test_a_beam_that_breaks_ends_the_track(scene: Scene, driver: LmfTracker) -> None:
    lost: list[TrackerError] = []
    driver.start_track(LEFT, 0.01, lost.append)
    tree(scene).Measurement.send(0, 10)
    tree(scene).lose_target()
    track = driver.end_track()
    assert [type(error) for error in lost] == [TargetLost]
    assert len(track.p_M) == 10
    scene.hidden.add("left")
    with pytest.raises(TargetLost):
        driver.start_track(LEFT, 0.01, lost.append)
    scene.hidden.clear()
    driver.start_track(LEFT, 0.01, lost.append)
    assert driver.measure(LEFT, 1.0).p_M == pytest.approx(LEFT)  # it ends the track
    assert len(driver.end_track().p_M) == 0


def test_an_error_of_lmf_ends_the_track_in_its_words(scene: Scene, driver: LmfTracker) -> None:
    lost: list[TrackerError] = []
    driver.start_track(LEFT, 0.01, lost.append)
    tree(scene).Measurement.send(0, 0, LmfException(4712, "Overload", "Too fast."))
    driver.end_track()
    assert "Overload: Too fast. (LMF 4712)" in str(lost[0])


def test_a_tracker_without_continuous_measurements_says_so(scene: Scene, tracker: Make) -> None:
    scene.continuous = False
    driver = tracker()
    assert driver.stream_limits() is None
    assert stream_of(driver) is None
    with pytest.raises(TrackerError, match="has no ContinuousTimeProfile"):
        driver.start_track(LEFT, 0.01, lambda error: None)


def test_settings_that_lmf_does_not_take_are_named(scene: Scene, tracker: Make) -> None:
    scene.ignored_settings.add("PacketRate")
    driver = tracker()
    with pytest.raises(TrackerError, match="PacketRate does not take 50; it stays at 5"):
        driver.start_track(LEFT, 0.001, lambda error: None)
    with pytest.raises(ValueError, match=r"one each 0\.001 to 1 s"):
        driver.start_track(LEFT, 1e-4, lambda error: None)


@pytest.mark.parametrize("fault", ["setting", "start"])
def test_after_a_track_that_did_not_begin_it_measures_at_rest(scene: Scene, driver: LmfTracker, fault: str) -> None:
    if fault == "setting":
        scene.ignored_settings.add("PacketRate")
    else:
        scene.throws["StartMeasurement"] = LmfException(302, "Busy", "Not now.")
    with pytest.raises(TrackerError, match=r"PacketRate|Not now"):
        driver.start_track(LEFT, 0.001, lambda error: None)
    assert driver.measure(LEFT, 1.0).p_M == pytest.approx(LEFT)
    assert tree(scene).Measurement.MeasurementArrived.handlers == []
    assert len(driver.end_track().p_M) == 0
