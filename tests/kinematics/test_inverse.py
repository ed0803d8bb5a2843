"""Inverse kinematics on arms whose axes are nowhere exactly parallel or crossing."""

from __future__ import annotations

import numpy as np

from cellapp.kinematics.chain import flange_poses, smr_positions
from cellapp.kinematics.inverse import solve_pose
from tests.arms import OFF_AXIS, SEVEN, UR10, at_station, true_geometry


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


def test_a_pose_out_of_reach_is_said_to_be():
    geometry = at_station(UR10, OFF_AXIS)
    q = np.zeros((1, 6))
    wanted = smr_positions(geometry, q) + np.array([[0.0, 0.0, 5.0]])
    found = solve_pose(geometry, wanted, flange_poses(geometry, q)[0], q)
    assert not found.reached[0]
    assert found.position_error[0] > 1.0
