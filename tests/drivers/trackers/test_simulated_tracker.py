"""The simulated tracker: noise, field of view, choice of the SMR."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.arms.simulated import CYCLE_S, SimulatedArm
from drivers.plant.optics import why_hidden
from drivers.trackers.imperfections import Imperfections, refractivity
from drivers.trackers.protocol import (
    PACKETS_HZ,
    NotReady,
    Preparation,
    TargetLost,
    Track,
    TrackerError,
    TrackerLinkLost,
    Unstable,
    stream_of,
)
from drivers.trackers.simulated import INITIALISE_S, POINTING_S, SETTLE_S, SimulatedTracker
from tests.approved import assert_refused
from tests.arms import dh_frames

SPEED, ACCELERATION = np.full(6, 1.0), np.full(6, 2.0)


def _ready(plant, *wrong, **options):
    tracker = SimulatedTracker(plant, *wrong, **options)
    tracker.connect()
    return tracker


def _smr(plant, name="left"):
    return next(target.p_M for target in plant.targets() if target.arm == name)


def test_the_noise_is_half_the_permissible_error_along_and_across_the_beam(make_plant):
    plant = make_plant(noise=True, tracker={"transverse": (15e-6, 6e-6), "range": (10e-6, 0.3e-6)})
    point = np.array([1.0, -3.0, 0.5])
    distance = np.linalg.norm(point)
    read, covariance = plant.measure_positions(np.tile(point, (20_000, 1)), np.random.default_rng(0))
    beam = point / distance
    side = np.cross(beam, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, beam)
    errors = (read - point) @ np.stack([beam, side, up], axis=1)
    along, across = 0.5 * (10e-6 + 0.3e-6 * distance), 0.5 * (15e-6 + 6e-6 * distance)
    # 20 000 draws: 0.5 % relative error of a standard deviation
    assert errors.std(axis=0) == pytest.approx([along, across, across], rel=0.025)
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 0.04
    assert np.abs(errors.mean(axis=0)).max() < 5 * across / np.sqrt(20_000)
    expected = across**2 * (np.eye(3) - np.outer(beam, beam)) + along**2 * np.outer(beam, beam)
    assert covariance[7] == pytest.approx(expected, rel=1e-12, abs=1e-24)


def test_the_field_of_view_has_its_edges_as_approved(make_config):
    """Lines name limits of the tracker, a place and the direction that its SMR faces; acceptance is 30 degrees."""

    def why(field: str, place: str, facing: str) -> str:
        tracker = make_config(tracker=json.loads(field)).tracker
        p, normal = (np.array(one.split(), dtype=float) for one in (place, facing))
        return why_hidden(tracker, p, normal / np.linalg.norm(normal), np.radians(30.0)) or "seen"

    assert_refused(Path(__file__).parent / "approved" / "field-of-view.txt", why)


def test_the_nearest_visible_smr_is_locked_whosever_it_is(make_arm, make_plant):
    plant = make_plant(make_arm(), make_arm("ur10", "right", 0.06))  # two arms in one another, 60 mm apart
    tracker = _ready(plant)
    left, right = _smr(plant, "left"), _smr(plant, "right")
    assert np.linalg.norm(left - right) == pytest.approx(0.06)
    assert tracker.measure(left, 1.0).p_M == pytest.approx(left, abs=1e-9)
    assert tracker.measure(0.4 * left + 0.6 * right, 1.0).p_M == pytest.approx(right, abs=1e-9)
    tracker.covered.add("left")
    assert tracker.measure(left, 1.0).p_M == pytest.approx(right, abs=1e-9)
    tracker.covered.add("right")
    with pytest.raises(TargetLost, match="arm left is there, but something covers it; that of arm right"):
        tracker.measure(left, 1.0)


# -- line of sight -----------------------------------------------------------------------------------------------------

NEST = np.array([0.8, 2.0, -0.4])
ACROSS = np.array([0.0, 0.0, 1.0])


def _capsule_of(plant, name):
    """Ends (3,) in M and radius of the forearm of an arm at the zero position."""
    arm = next(arm for arm in plant.config.arms if arm.name == name)
    capsule = next(c for c in arm.capsules if c.frame == 3)
    frame = plant.true_T_M_B(name) @ dh_frames(arm.rows, np.zeros(6))[3]
    return [frame[:3, :3] @ end + frame[:3, 3] for end in (capsule.start, capsule.end)], capsule.radius


@pytest.mark.parametrize("off", [0.0, 0.9, 1.1])
def test_a_body_in_the_beam_hides_what_is_behind_it(make_arm, make_plant, off):
    plant = make_plant(make_arm(), make_arm("ur5", "right", 1.2))
    (start, end), radius = _capsule_of(plant, "right")
    middle = 0.5 * (start + end)
    beam = middle / np.linalg.norm(middle)
    aside = np.cross(beam, end - start)
    aside *= off * radius / np.linalg.norm(aside)  # the beam passes the axis at this distance
    behind = 1.3 * (middle + aside)
    tracker = _ready(plant, nests={"behind": behind, "before": 0.7 * behind})
    assert tracker.measure(0.7 * behind, 1.0).p_M == pytest.approx(0.7 * behind)
    if off < 1.0:
        with pytest.raises(TargetLost, match="that of nest behind is there, but arm right blocks the beam"):
            tracker.measure(behind, 1.0)
    else:
        assert tracker.measure(behind, 1.0).p_M == pytest.approx(behind)


def test_an_arm_that_crosses_the_beam_breaks_it(make_arm, make_plant):
    plant = make_plant(make_arm(), make_arm("ur5", "right", 1.2))
    (start, end), _ = _capsule_of(plant, "right")
    behind = 1.3 * 0.5 * (start + end)
    plant.start_move("right", np.array([0.0, -1.5, 0, 0, 0, 0]), SPEED, ACCELERATION)
    plant.advance(10.0)
    tracker = _ready(plant, nests={"behind": behind})
    tracker.measure(behind, 1.0)
    plant.start_move("right", np.zeros(6), SPEED, ACCELERATION)
    with pytest.raises(TargetLost, match="SMR of nest behind broke in mid-measurement: arm right blocks"):
        tracker.measure(behind, 5.0)


# -- rest --------------------------------------------------------------------------------------------------------------


def test_an_arm_that_has_only_just_stopped_still_shakes(make_plant):
    plant = make_plant()
    tracker = _ready(plant)
    here = _smr(plant)

    def arrive(before_s):
        goal = np.array([0, 0, 0, 0, 0, 0.2 if plant.q("left")[5] == 0.0 else 0.0])
        plant.start_move("left", goal, SPEED, ACCELERATION)
        plant.advance(plant.rest_s("left") - plant.clock_s - before_s)

    arrive(POINTING_S - 0.5 * SETTLE_S)
    with pytest.raises(Unstable, match="the SMR of arm left moved while it was measured"):
        tracker.measure(here, 1.0)
    assert tracker.measure(here, 1.0).p_M == pytest.approx(_smr(plant))
    arrive(POINTING_S - 1.5 * SETTLE_S)
    assert tracker.measure(here, 1.0).p_M == pytest.approx(_smr(plant))


# -- the tracker's own errors ------------------------------------------------------------------------------------------


def test_it_drifts_while_it_warms_up(make_plant):
    plant = make_plant()
    wrong = Imperfections(warm_up_rad=(0.0, 0.0, 1e-4), warm_up_m=30e-6, warm_up_s=1800.0)
    tracker = _ready(plant, wrong, nests={"n": NEST}, switched_on_s=0.0)
    distance, flat = np.linalg.norm(NEST), np.hypot(NEST[0], NEST[1])
    for age_s in (10.0, 1800.0, 4 * 3600.0):
        plant.advance(age_s - plant.clock_s - POINTING_S)
        off = tracker.measure(NEST, 1.0).p_M - NEST
        left = np.exp(-age_s / 1800.0)
        along = off @ NEST / distance
        assert along == pytest.approx(30e-6 * left, abs=2e-8)  # a turn by 1e-4 brings 1e-8 to the length
        sideways = np.cross(ACROSS, NEST) / flat  # it turns about its standing axis
        assert off @ sideways == pytest.approx(1e-4 * flat * left, abs=1e-8)
    assert np.linalg.norm(off) < 0.4e-6 + 1e-4 * distance * np.exp(-8)


def test_the_laser_must_be_warm(make_plant):
    plant = make_plant()
    tracker = _ready(plant, Imperfections(laser_s=300.0), nests={"n": NEST}, switched_on_s=0.0)
    plant.advance(100.0)
    assert tracker.unmet() == ["its laser is warming up, 200 s are left"]
    with pytest.raises(NotReady, match="its laser is warming up, 200 s are left"):
        tracker.measure(NEST, 1.0)
    plant.advance(200.0)
    tracker.measure(NEST, 1.0)


def test_refraction_is_that_of_the_published_table():
    normal = refractivity(20.0, 1013.25, 50.0)
    assert normal == pytest.approx(271.4e-6, abs=0.2e-6)
    assert refractivity(21.0, 1013.25, 50.0) - normal == pytest.approx(-0.95e-6, abs=0.02e-6)
    assert refractivity(20.0, 1014.25, 50.0) - normal == pytest.approx(0.268e-6, abs=0.005e-6)
    assert refractivity(20.0, 1013.25, 60.0) - normal == pytest.approx(-0.085e-6, abs=0.005e-6)


def test_refraction_that_is_not_corrected_scales_the_cell(make_plant):
    true: dict[str, Any] = {"pressure_hpa": 940.0, "humidity_percent": 30.0}
    plant = make_plant(temperature_c=28.0)
    distance = np.linalg.norm(NEST)

    def scale_ppm(tracker):
        point = tracker.measure(NEST, 1.0)
        assert np.cross(point.p_M, NEST) == pytest.approx(np.zeros(3), abs=1e-9)
        return (np.linalg.norm(point.p_M) / distance - 1.0) * 1e6, point

    with_station, point = scale_ppm(_ready(plant, Imperfections(**true), nests={"n": NEST}))
    assert with_station == 0.0
    assert (point.pressure_hpa, point.humidity_percent) == (940.0, 30.0)

    blind = _ready(plant, Imperfections(**true, weather_station=False), nests={"n": NEST})
    without, point = scale_ppm(blind)
    # -0.95 ppm/K and 0.268 ppm/hPa from standard air: light is faster here than it believes
    assert without == pytest.approx(-0.95 * 8.0 - 0.268 * 73.25 + 0.085 * 2.0, abs=1.5)
    assert (point.temperature_c, point.pressure_hpa) == (20.0, 1013.25)
    assert point.quality == ("no weather station: refraction was corrected for standard air",)

    blind.prepare(Preparation(temperature_c=plant.air_c, pressure_hpa=940.0, humidity_percent=30.0))
    by_hand, point = scale_ppm(blind)
    assert by_hand == pytest.approx(0.0, abs=0.01)
    assert point.quality == ()


# -- setting up, starting anew -----------------------------------------------------------------------------------------


def test_after_a_restart_it_must_be_prepared(make_plant):
    plant = make_plant()
    tracker = _ready(plant, nests={"n": NEST})
    tracker.prepare(Preparation(temperature_c=30.0))
    assert plant.clock_s == 0.0  # nothing had to be initialised
    assert tracker.measure(NEST, 1.0).temperature_c == 30.0
    tracker.reboot(down_s=60.0)
    for call in (tracker.unmet, tracker.connect, lambda: tracker.measure(NEST, 1.0)):
        with pytest.raises(TrackerLinkLost, match="down: the tracker is starting"):
            call()
    plant.advance(60.0)
    with pytest.raises(TrackerLinkLost, match="connect first"):
        tracker.unmet()
    tracker.connect()
    assert tracker.unmet() == ["it has not been initialised since it was switched on"]
    with pytest.raises(NotReady, match="not been initialised"):
        tracker.measure(NEST, 1.0)
    before = plant.clock_s
    tracker.prepare(Preparation())
    assert plant.clock_s - before == pytest.approx(INITIALISE_S)
    assert tracker.measure(NEST, 1.0).temperature_c != 30.0  # settings do not survive


def test_settings_it_does_not_have_are_refused(make_plant):
    tracker = _ready(make_plant())
    with pytest.raises(ValueError, match=r"no reflector 'RRR 1.5 in'; it has 'simulated 1.5 in'"):
        tracker.prepare(Preparation(reflector="RRR 1.5 in"))
    for bad in ({"accuracy": "best"}, {"temperature_c": 293.0}, {"pressure_hpa": 1.0}, {"humidity_percent": 0.5e3}):
        with pytest.raises(ValueError, match="tracker: "):
            Preparation(**bad)


# -- The stream: packets, its own clock, late arrivals, saturation and triggers ----------------------------------------


INTERVAL_S = 0.004
WAY = np.array([0.2, 0.1, -0.1, 0.1, 0.1, -0.2])
CLOCK = Imperfections(clock_offset_s=512.0, clock_rate=20e-6, packet_jitter_s=0.04)


@pytest.fixture
def plant(make_arm, make_plant):
    return make_plant(make_arm(effects={"backlash": {"play": [2e-4] * 6}}), make_arm("ur5", "right", 1.2), noise=False)


def swung(plant, errors=CLOCK, there_s=2.0):
    """A track of the left arm, which moves there and back; packets, the errors that ended it, the true motion."""
    tracker, arm = SimulatedTracker(plant, errors), SimulatedArm(plant, "left")
    tracker.connect()
    arm.connect()
    packets: list[Track] = []
    lost: list[TrackerError] = []
    tracker.start_track(plant.targets()[0].p_M, INTERVAL_S, lost.append, packets.append)
    x = np.linspace(0.0, 1.0, round(there_s / CYCLE_S) + 1)[:, None]
    there = plant.q("left") + x**3 * (10.0 - x * (15.0 - 6.0 * x)) * WAY
    arm.start_path(np.concatenate([there, there[::-1]]), CYCLE_S)
    seen = []
    for _ in range(round((2.0 * there_s + 0.5) / CYCLE_S)):
        plant.advance(CYCLE_S)
        seen.append((plant.clock_s, plant.targets()[0].p_M))
    return tracker, tracker.end_track(), packets, lost, seen


def test_points_are_those_of_the_moving_arm_at_their_own_stamps(plant):
    tracker, track, _, lost, seen = swung(plant)
    assert stream_of(tracker) is tracker
    assert lost == []
    np.testing.assert_allclose(np.diff(track.device_time_s), INTERVAL_S * (1.0 + 20e-6), rtol=1e-6)
    at_s = (track.device_time_s - CLOCK.clock_offset_s) / (1.0 + CLOCK.clock_rate)
    times = np.array([time_s for time_s, _ in seen])
    wanted = np.column_stack([np.interp(at_s, times, column) for column in np.array([p for _, p in seen]).T])
    inside = (at_s > times[0]) & (at_s < times[-1])
    # interpolation errs by a h^2 / 8; the play of six joints, 0.2 mm and more, is crossed at the reversal, no earlier
    off = np.linalg.norm(track.p_M - wanted, axis=1)[inside]
    assert np.quantile(off, 0.99) < 1e-5
    assert (off > 2e-5).sum() <= 6
    assert np.isfinite(track.sigma_m).all()


def test_packets_come_late_and_at_most_fifty_a_second(plant):
    _, track, packets, _, _ = swung(plant)
    assert len(packets) / np.ptp(track.device_time_s) <= PACKETS_HZ * 1.05
    assert max(len(packet.p_M) for packet in packets) >= 5
    at_s = (track.device_time_s - CLOCK.clock_offset_s) / (1.0 + CLOCK.clock_rate)
    late = track.arrived_s - at_s
    assert late.min() >= -1e-9
    assert late.max() > 0.03
    # the shortest delay is known to some milliseconds, and no better
    assert 0.0 <= np.mean(track.time_s - at_s) < 5e-3


def test_a_slow_receiver_loses_points_and_they_are_counted(plant):
    _, track, _, _, _ = swung(plant, Imperfections(saturated=0.2))
    whole = round(np.ptp(track.device_time_s) / INTERVAL_S) + 1
    assert track.missing(INTERVAL_S) == whole - len(track.p_M)
    assert 0.05 * whole < track.missing(INTERVAL_S) < 0.4 * whole
