"""LMF's continuous measurement on the stand-in: packets, stamps, a beam that breaks, stationary ones after it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from drivers.trackers.lmf_settings import LmfSettings
from drivers.trackers.lmf_stream import LmfStreamTracker
from drivers.trackers.protocol import Packet, Preparation, TargetLost, TrackerError, stream_of
from tests.drivers.trackers.fake_lmf import LmfException, Scene

LEFT = np.array([3.0, 0.4, -0.2])


@pytest.fixture
def scene() -> Iterator[Scene]:
    scene = Scene(targets={"left": LEFT}, initialised=True)
    yield scene
    scene.release.set()
    assert scene.violations == []


@pytest.fixture
def tracker(scene: Scene) -> Iterator[Callable[..., LmfStreamTracker]]:
    made: list[LmfStreamTracker] = []

    def make(**settings: Any) -> LmfStreamTracker:
        use = LmfSettings(address="192.168.0.1", **settings)
        made.append(LmfStreamTracker(use, Preparation(), load=lambda library: scene.lmf()))
        made[-1].connect()
        return made[-1]

    yield make
    for driver in made:
        driver.disconnect()


def measurement(scene: Scene) -> Any:
    return scene.persistent["tracker"].Measurement


@pytest.mark.parametrize(("interval_s", "rate"), [(0.001, 50), (0.004, 50), (0.1, 10)])
def test_points_come_in_packets_with_the_controllers_stamps(
    scene: Scene, tracker: Callable[..., LmfStreamTracker], interval_s: float, rate: int
) -> None:
    driver = tracker()
    assert stream_of(driver) is driver
    seen: list[Packet] = []
    lost: list[TrackerError] = []
    driver.start_track(LEFT, interval_s, lost.append, seen.append)
    profile = measurement(scene).Profiles.Selected
    assert profile.TimeSeparation.Value == pytest.approx(interval_s * 1e3)
    assert profile.PacketRate.Value == rate
    for packet in range(5):
        measurement(scene).send(20 * packet, 20)
    track = driver.end_track()
    assert lost == []
    assert [len(one.p_M) for one in seen] == [20] * 5
    np.testing.assert_allclose(np.diff(track.device_time_s), interval_s, atol=1e-6)
    np.testing.assert_allclose(track.p_M, np.repeat(LEFT[None], 100, axis=0), atol=1e-9)
    assert (track.sigma_m > 5e-6).all()
    assert (np.diff(track.arrived_s) >= 0.0).all()
    assert scene.calls.count("StopMeasurement") == 1
    assert driver.measure(LEFT, 1.0).p_M == pytest.approx(LEFT)  # the stationary profile is back


def test_a_beam_that_breaks_ends_the_track(scene: Scene, tracker: Callable[..., LmfStreamTracker]) -> None:
    driver = tracker()
    lost: list[TrackerError] = []
    driver.start_track(LEFT, 0.01, lost.append)
    measurement(scene).send(0, 10)
    scene.persistent["tracker"].lose_target()
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


def test_an_error_of_lmf_ends_the_track_in_its_words(scene: Scene, tracker: Callable[..., LmfStreamTracker]) -> None:
    driver = tracker()
    lost: list[TrackerError] = []
    driver.start_track(LEFT, 0.01, lost.append)
    measurement(scene).send(0, 0, LmfException(4712, "Overload", "Too fast."))
    driver.end_track()
    assert "Overload: Too fast. (LMF 4712)" in str(lost[0])


def test_a_tracker_without_continuous_measurements_says_so(
    scene: Scene, tracker: Callable[..., LmfStreamTracker]
) -> None:
    scene.continuous = False
    driver = tracker()
    assert driver.stream_limits() is None
    assert stream_of(driver) is None
    with pytest.raises(TrackerError, match="has no ContinuousTimeProfile"):
        driver.start_track(LEFT, 0.01, lambda error: None)


def test_settings_that_lmf_does_not_take_are_named(scene: Scene, tracker: Callable[..., LmfStreamTracker]) -> None:
    scene.ignored_settings.add("PacketRate")
    driver = tracker()
    with pytest.raises(TrackerError, match="PacketRate does not take 50; it stays at 5"):
        driver.start_track(LEFT, 0.001, lambda error: None)
    with pytest.raises(ValueError, match=r"one each 0\.001 to 1 s"):
        driver.start_track(LEFT, 1e-4, lambda error: None)


@pytest.mark.parametrize("fault", ["setting", "start"])
def test_after_a_track_that_did_not_begin_it_measures_at_rest(
    scene: Scene, tracker: Callable[..., LmfStreamTracker], fault: str
) -> None:
    driver = tracker()
    if fault == "setting":
        scene.ignored_settings.add("PacketRate")
    else:
        scene.throws["StartMeasurement"] = LmfException(302, "Busy", "Not now.")
    with pytest.raises(TrackerError, match=r"PacketRate|Not now"):
        driver.start_track(LEFT, 0.001, lambda error: None)
    assert driver.measure(LEFT, 1.0).p_M == pytest.approx(LEFT)
    assert measurement(scene).MeasurementArrived.handlers == []
    assert len(driver.end_track().p_M) == 0
