"""Inverse kinematics on arms whose axes are nowhere exactly parallel or crossing."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.robot.kinematics.chain import flange_poses, smr_positions
from cellapp.robot.kinematics.inverse import solve_pose
from cellapp.robot.kinematics.transforms import rotation_from_vector
from tests.arms import OFF_AXIS, ON_AXIS, SEVEN, UR10, at_station, true_geometry


def test_poses_of_a_calibrated_arm_are_reached_from_near_by():
    rng = np.random.default_rng(0)
    for rows in (UR10, SEVEN):
        geometry = true_geometry(at_station(rows, OFF_AXIS), rng)
        q = rng.uniform(-2.5, 2.5, (100, len(rows)))
        wanted, (rotation, _) = smr_positions(geometry, q), flange_poses(geometry, q)
        found = solve_pose(geometry, wanted, rotation, q + rng.normal(0.0, 0.03, q.shape))
        assert found.reached.mean() > 0.97  # the rest stands at a singularity
        there = found.q[found.reached]
        np.testing.assert_allclose(smr_positions(geometry, there), wanted[found.reached], atol=1e-9)
        np.testing.assert_allclose(flange_poses(geometry, there)[0], rotation[found.reached], atol=1e-9)


def test_a_pose_out_of_reach_is_reported():
    geometry = at_station(UR10, OFF_AXIS)
    q = np.zeros((1, 6))
    wanted = smr_positions(geometry, q) + np.array([[0.0, 0.0, 5.0]])
    found = solve_pose(geometry, wanted, flange_poses(geometry, q)[0], q)
    assert not found.reached[0]
    assert found.position_error[0] > 1.0


@pytest.mark.parametrize("max_iterations", [0, 60])
def test_a_flange_half_a_turn_off_does_not_count_as_reached(max_iterations):
    """The SMR lies on the last axis: half a turn of the last joint keeps its position and reverses the flange."""
    geometry = at_station(UR10, ON_AXIS)
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (20, 6))
    start = q + np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.pi])
    wanted, (rotation, _) = smr_positions(geometry, q), flange_poses(geometry, q)
    found = solve_pose(geometry, wanted, rotation, start, max_iterations=max_iterations)
    reversed_flange = np.einsum("nab,nab->n", flange_poses(geometry, found.q)[0], rotation) < 0.0
    assert not found.reached[reversed_flange].any()
    np.testing.assert_allclose(found.rotation_error[reversed_flange], np.pi, atol=1e-6)
    if max_iterations:
        assert found.reached.mean() > 0.9


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8]], ids=str)
def test_a_wanted_rotation_half_a_turn_from_the_start_is_solved_or_reported(axis):
    geometry = at_station(UR10, OFF_AXIS)
    q = np.random.default_rng(2).uniform(-1.5, 1.5, (30, 6))
    rotation, wanted = flange_poses(geometry, q)[0], smr_positions(geometry, q)
    turned = rotation @ rotation_from_vector(np.pi * np.array(axis))
    found = solve_pose(geometry, wanted, turned, q)
    there = found.q[found.reached]
    np.testing.assert_allclose(flange_poses(geometry, there)[0], turned[found.reached], atol=1e-9)
    np.testing.assert_allclose(smr_positions(geometry, there), wanted[found.reached], atol=1e-9)
    assert found.reached.mean() > 0.3
