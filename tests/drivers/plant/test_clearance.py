"""The collision monitor against distances from dense sampling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.plant import Plant
from drivers.plant.clearance import segment_distances

SPEED, ACCELERATION = np.full(6, 2.0), np.full(6, 3.0)
coordinates = arrays(np.float64, (4, 3), elements=st.integers(-4, 4).map(lambda k: k / 4))


def _slow(a, b, c, d, count=201):
    share = np.linspace(0, 1, count)[:, None]
    p, q = a + share * (b - a), c + share * (d - c)
    return np.linalg.norm(p[:, None] - q[None], axis=-1).min()


@settings(max_examples=150, deadline=None)
@given(points=coordinates)
def test_segment_distances_are_those_of_their_nearest_points(points):
    a, b, c, d = points
    found = segment_distances(a, b, c, d)
    slow = _slow(a, b, c, d)
    # the samples lie within half a step of the nearest points, along both segments
    step = 0.5 * (np.linalg.norm(b - a) + np.linalg.norm(d - c)) / 200
    assert found <= slow + 1e-12
    assert found >= slow - step - 1e-12


def test_crossing_and_parallel_segments():
    x, y, z = np.eye(3)
    assert segment_distances(-x, x, z - y, z + y) == pytest.approx(1.0)
    assert segment_distances(-x, x, -y, y) == pytest.approx(0.0)
    assert segment_distances(-x, x, z - x, z + x) == pytest.approx(1.0)
    assert segment_distances(-x, 0 * x, x + z, 2 * x + z) == pytest.approx(np.sqrt(2.0))
    assert segment_distances(x, x, z, z) == pytest.approx(np.sqrt(2.0))


def _capsules(arm, frames):
    ends = [(c.frame, c.start, c.end, c.radius) for c in arm.capsules]
    poses = [arm.T_C_B @ frame for frame in frames]
    return [((poses[f] @ [*s, 1.0])[:3], (poses[f] @ [*e, 1.0])[:3], r, f) for f, s, e, r in ends]


def test_the_collision_monitor_finds_the_smallest_distance_of_a_motion(make_arm, make_config, dh_frames):
    left, right = make_arm(), make_arm("ur5", "right", 1.5)
    plant = Plant(make_config(left, right), watch_clearance=True)
    goals = {"left": np.array([0.9, -1.0, 1.2, 0.4, 0.3, 0.0]), "right": np.array([2.4, -0.7, 1.5, 0.0, 0.5, 0.0])}
    for name, goal in goals.items():
        plant.start_move(name, goal, SPEED, ACCELERATION)
    motions = {name: motion for name in goals if (motion := plant._arm(name).motion) is not None}
    assert plant.clearance is not None
    while any(plant.moving(name) for name in goals):
        plant.advance(0.13)
    arms, floor = np.inf, np.inf
    for time in np.arange(0.0, 2.0, 0.02):
        both = []
        for arm in (left, right):
            q = motions[arm.name].position(np.array([time]))[0]
            both.append(_capsules(arm, dh_frames(arm.rows, q)))
        for a, b, r, _ in both[0]:
            for c, d, s, _ in both[1]:
                arms = min(arms, _slow(a, b, c, d, 41) - r - s)
        floor = min([floor, *(min(a[2], b[2]) - r for body in both for a, b, r, frame in body if frame > 0)])
    assert plant.clearance.arms_m == pytest.approx(arms, abs=0.02)
    assert plant.clearance.floor_m == pytest.approx(floor, abs=0.02)
    assert 0.0 <= plant.clearance.arms_time_s <= 2.0


def test_a_collision_between_two_safe_end_points_is_detected(make_arm, make_config):
    right = make_arm("ur5", "right", 1.5)  # at zero it reaches towards the left arm
    here, there = np.zeros((2, 6))
    here[0], there[0] = np.pi - 1.3, np.pi + 1.3
    plant, at_the_end = (Plant(make_config(make_arm(home=home), right), watch_clearance=True) for home in (here, there))
    assert plant.clearance is not None
    assert at_the_end.clearance is not None
    assert min(plant.clearance.arms_m, at_the_end.clearance.arms_m) > 0.1
    plant.start_move("left", there, SPEED, ACCELERATION)
    plant.advance(60.0)
    assert plant.clearance.arms_m < 0.0
    assert 0.2 < plant.clearance.arms_time_s < 2.0


def test_the_floor_is_where_it_is_configured_and_a_fixed_base_is_not_counted(make_arm, make_config):
    plant = Plant(make_config(make_arm(home=np.zeros(6)), floor=0.3), watch_clearance=True)
    assert plant.clearance is not None
    # stretched out flat the flange is lowest: d1 - d5 above the base at 0.5, its capsule's radius 0.05;
    # the capsule of the base itself is lower still
    assert plant.clearance.floor_m == pytest.approx(0.5 + 0.1273 - 0.1157 - 0.05 - 0.3)
    assert plant.clearance.arms_m == np.inf


def test_the_collision_monitor_is_off_by_default(make_plant):
    assert make_plant().clearance is None
