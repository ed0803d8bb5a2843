"""Noise, field of view, and which SMR is locked."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.arms.simulated import SimulatedArm
from drivers.plant.optics import covariances, why_hidden
from drivers.trackers.protocol import NotReady, TargetLost, TrackerLinkLost, Unstable
from drivers.trackers.simulated import SimulatedTracker

SPEED, ACCELERATION = np.full(6, 1.0), np.full(6, 2.0)


def _ready(plant):
    tracker = SimulatedTracker(plant)
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


def test_averaging_longer_is_quieter_and_its_covariance_says_so(make_plant):
    plant = make_plant(noise=True)
    p = np.tile([0.5, 3.0, 0.2], (5000, 1))
    short, wide = plant.measure_positions(p, np.random.default_rng(0))
    long, narrow = plant.measure_positions(p, np.random.default_rng(0), averaging_s=4.0)
    assert (long - p) == pytest.approx(0.5 * (short - p), abs=1e-15)
    assert narrow == pytest.approx(0.25 * wide, rel=1e-12)


def test_without_noise_the_point_is_the_truth_and_the_covariance_stays(make_config, make_plant, dh_smr):
    plant = make_plant()
    q = np.random.default_rng(0).uniform(-2, 2, (1, 6))
    plant.start_move("left", q[0], SPEED, ACCELERATION)
    plant.advance(10.0)
    truth = dh_smr(make_config(), q)
    point = _ready(plant).measure(truth[0] + 0.01, 2.0)
    assert np.abs(point.p_M - truth[0]).max() < 1e-12
    expected = covariances(plant.config.tracker, truth, 2.0)[0]
    assert point.covariance_M == pytest.approx(expected, rel=1e-9)
    assert point.averaging_s == 2.0


def test_the_same_seed_reads_the_same_and_time_passes(make_plant):
    def readings(seed):
        plant = make_plant(noise=True, seed=seed)
        tracker = _ready(plant)
        points = [tracker.measure(_smr(plant), 1.5) for _ in range(3)]
        assert np.diff([point.time_s for point in points]) == pytest.approx(2.0)
        assert points[0].temperature_c == pytest.approx(20.0, abs=0.5)
        return np.array([point.p_M for point in points])

    assert np.array_equal(readings(3), readings(3))
    assert not np.array_equal(readings(3), readings(4))
    assert np.ptp(readings(3), axis=0).min() > 0.0


@pytest.mark.parametrize(
    ("field", "p", "normal", "why"),
    [
        ({}, [3, 0, 0], [-1, 0, 0], ""),
        ({"distance": (1.0, 2.0)}, [3, 0, 0], [-1, 0, 0], "it is 3.000 m away"),
        ({"distance": (4.0, 9.0)}, [3, 0, 0], [-1, 0, 0], "it is 3.000 m away"),
        ({"azimuth": (-1.0, 1.0)}, [0, 3, 0], [0, -1, 0], "its azimuth is 90.0 deg"),
        ({"azimuth": (0.0, 2.0)}, [0, 3, 0], [0, -1, 0], ""),
        ({"azimuth": (3.0, 3.5)}, [-3, -0.1, 0], [1, 0, 0], ""),
        ({"azimuth": (3.0, 3.5)}, [3, 0.1, 0], [-1, 0, 0], "its azimuth is 1.9 deg"),
        ({"elevation": (-0.5, 0.5)}, [2, 0, 2], [-1, 0, -1], "its elevation is 45.0 deg"),
        ({"elevation": (-0.9, 0.5)}, [2, 0, -2], [-1, 0, 1], ""),
        ({}, [3, 0, 0], [-1, 0.5, 0], ""),
        ({}, [3, 0, 0], [-1, 0.6, 0], "it is turned 31.0 deg away; it accepts 30.0 deg"),
        ({}, [3, 0, 0], [1, 0, 0], "it is turned 180.0 deg away"),
    ],
)
def test_the_field_of_view_has_its_edges(make_config, field, p, normal, why):
    direction = np.array(normal, dtype=float)
    direction /= np.linalg.norm(direction)
    found = why_hidden(make_config(tracker=field).tracker, np.array(p, dtype=float), direction, np.radians(30.0))
    assert found.startswith(why)
    assert bool(found) == bool(why)


def test_an_smr_that_looks_away_is_lost(make_arm, make_plant):
    plant = make_plant(make_arm(smr_acceptance=np.radians(30.0)))
    here = _smr(plant)  # at the zero position the flange looks along the base's -y: at the tracker
    tracker = _ready(plant)
    assert tracker.measure(here, 1.0).p_M == pytest.approx(here)
    plant.start_move("left", np.array([0, 0, 0, 0, np.pi / 2, 0]), SPEED, ACCELERATION)
    plant.advance(10.0)
    with pytest.raises(TargetLost, match=r"no SMR within 100 mm of .* that of arm left is there, but it is turned"):
        tracker.measure(_smr(plant), 1.0)


def test_nothing_there_is_lost(make_plant):
    plant = make_plant()
    tracker = _ready(plant)
    here, up = _smr(plant), np.array([0.0, 0.0, 1.0])
    assert tracker.measure(here + 0.099 * up, 1.0).p_M == pytest.approx(here)
    with pytest.raises(TargetLost, match=r"no SMR within 100 mm of \([-0-9., ]+\) m$"):
        tracker.measure(here + 0.101 * up, 1.0)


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


def test_a_moving_target_is_unstable_a_moving_neighbour_is_not(make_arm, make_plant):
    plant = make_plant(make_arm(), make_arm("ur5", "right", 1.2))
    tracker, arm = _ready(plant), SimulatedArm(plant, "left")
    arm.connect()
    here = _smr(plant, "left")
    arm.start_move(np.array([0, 0, 0, 0, 0, 3.0]), SPEED, ACCELERATION)
    assert tracker.measure(_smr(plant, "right"), 1.0).p_M == pytest.approx(_smr(plant, "right"))
    with pytest.raises(Unstable, match="the SMR of arm left moved while it was measured"):
        tracker.measure(here, 1.0)
    arm.wait_settled(10.0)
    assert tracker.measure(here, 1.0).p_M == pytest.approx(_smr(plant, "left"))


def test_what_keeps_it_from_measuring_is_said(make_plant):
    plant = make_plant()
    tracker = SimulatedTracker(plant)
    with pytest.raises(TrackerLinkLost, match="connect first"):
        tracker.measure(np.ones(3), 1.0)
    tracker.connect()
    assert tracker.unmet() == []
    tracker.obstacles += ["it is warming up", "it is not level"]
    assert tracker.unmet() == ["it is warming up", "it is not level"]
    with pytest.raises(NotReady, match="it is warming up; it is not level"):
        tracker.measure(np.ones(3), 1.0)
    tracker.obstacles.clear()
    with pytest.raises(ValueError, match="averaging must last longer than 0 s"):
        tracker.measure(_smr(plant), 0.0)
    tracker.cut_link()
    with pytest.raises(TrackerLinkLost, match="cut"):
        tracker.connect()
    tracker.release()
    tracker.connect()
    assert tracker.identify().serial == "SIM-tracker"
    tracker.disconnect()
    tracker.disconnect()
    with pytest.raises(TrackerLinkLost):
        tracker.unmet()
