"""The chain against a plain product of matrices, against differences, and against the plant's axes in space."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.robot.kinematics.chain import (
    JointAngles,
    Workspace,
    flange_poses,
    frame_poses,
    jacobian,
    nominal_geometry,
    parallel_rows,
    parameter_names,
    smr_positions,
)
from cellapp.robot.kinematics.transforms import rotation_from_vector, rotation_x, rotation_y, rotation_z, transform
from tests.arms import OFF_AXIS, SEVEN, STATION, UR5, UR10, at_station, plant_of

seeds = st.integers(0, 2**32 - 1)


def random_arm(rng, joints):
    rows = np.column_stack(
        [rng.uniform(-3, 3, joints), rng.uniform(-0.5, 0.5, (joints, 2)), rng.uniform(-3, 3, joints)]
    )
    T_M_B = transform(rotation_from_vector(rng.normal(size=3)), rng.uniform(-3, 3, 3))
    geometry = nominal_geometry(rows, rng.uniform(-0.2, 0.2, 3), T_M_B)
    vector = geometry.vector()
    vector[6:-3] += rng.normal(0.0, 0.1, 5 * joints)  # betas too, everywhere
    return geometry.with_vector(vector)


def plain_product(geometry, q):
    """T_M_S by 4 x 4 matrices, one pose at a time, straight from the definition."""
    T = transform(np.eye(3), np.zeros(3))
    x0, y0, z0, alpha0, beta0, theta0 = geometry.base
    T[:3, :3] = geometry.reference()
    T = T @ transform(np.eye(3), [x0, y0, 0.0]) @ transform(rotation_x(alpha0), np.zeros(3))
    T = T @ transform(rotation_y(beta0), np.zeros(3)) @ transform(np.eye(3), [0, 0, z0])
    T = T @ transform(rotation_z(theta0), np.zeros(3))
    for q_i, (theta, d, a, alpha, beta) in zip(q, geometry.rows, strict=True):
        T = T @ transform(rotation_z(q_i + theta), np.zeros(3)) @ transform(np.eye(3), [a, 0, d])
        T = T @ transform(rotation_x(alpha) @ rotation_y(beta), np.zeros(3))
    return T


@given(seeds, st.integers(2, 8))
@settings(max_examples=60, deadline=None)
def test_positions_agree_with_the_product_of_matrices(seed, joints):
    rng = np.random.default_rng(seed)
    geometry = random_arm(rng, joints)
    q = rng.uniform(-6, 6, (5, joints))
    rotations, origins = flange_poses(geometry, q)
    for k in range(len(q)):
        T = plain_product(geometry, q[k])
        np.testing.assert_allclose(rotations[k], T[:3, :3], atol=1e-13)
        np.testing.assert_allclose(origins[k], T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(smr_positions(geometry, q)[k], T[:3, :3] @ geometry.tool + T[:3, 3], atol=1e-12)


@given(seeds, st.integers(2, 8))
@settings(max_examples=40, deadline=None)
def test_jacobian_is_the_derivative_of_the_positions(seed, joints):
    rng = np.random.default_rng(seed)
    geometry = random_arm(rng, joints)
    q = rng.uniform(-6, 6, (4, joints))
    columns = tuple(rng.permutation(len(parameter_names(joints))).tolist())  # any order
    P, J = jacobian(geometry, JointAngles.of(q), columns)
    np.testing.assert_allclose(P.T, smr_positions(geometry, q), atol=1e-13)
    vector, h = geometry.vector(), 1e-5
    for place, column in enumerate(columns):
        step = np.zeros_like(vector)
        step[column] = h
        ahead, behind = geometry.with_vector(vector + step), geometry.with_vector(vector - step)
        difference = (smr_positions(ahead, q) - smr_positions(behind, q)).T / (2.0 * h)
        np.testing.assert_allclose(J[:, place], difference, atol=2e-9 * max(1.0, np.abs(P).max()))


def test_a_workspace_is_used_again_and_changes_no_result():
    rng, workspace = np.random.default_rng(0), Workspace()
    columns = (9, 14, 19, 7, 8)  # rotations before translations, as all sets have them
    for n in (5, 3, 5):  # as with a last chunk that is smaller
        geometry, angles = random_arm(rng, 6), JointAngles.of(rng.uniform(-6, 6, (n, 6)))
        _, J = jacobian(geometry, angles, columns, workspace)
        np.testing.assert_array_equal(J, jacobian(geometry, angles, columns)[1])
        _, again = jacobian(geometry, angles, columns, workspace)
        assert np.shares_memory(J, again)


def test_a_workspace_keeps_purposes_apart():
    workspace = Workspace()
    (one,), (other,) = workspace.arrays("one", (2, 3)), workspace.arrays("other", (2, 3))
    assert not np.shares_memory(one, other)
    first, second = workspace.arrays("both", (2, 3), (4,))
    assert (first.shape, second.shape) == ((2, 3), (4,))
    assert workspace.arrays("one", (2, 3))[0] is one


@given(seeds)
@settings(max_examples=100, deadline=None)
def test_a_base_pose_survives_the_round_trip(seed):
    rng = np.random.default_rng(seed)
    T_M_B = transform(rotation_from_vector(rng.normal(size=3) * 2.0), rng.uniform(-5, 5, 3))
    geometry = nominal_geometry(UR10, OFF_AXIS, T_M_B)
    np.testing.assert_allclose(geometry.T_M_B(), T_M_B, atol=1e-9)


@pytest.mark.parametrize("rows", [UR10, UR5, SEVEN], ids=["UR10", "UR5", "seven joints"])
def test_the_plant_agrees_when_all_its_errors_are_off(rows):
    geometry, plant = at_station(rows, OFF_AXIS), plant_of(rows, OFF_AXIS)
    q = np.random.default_rng(3).uniform(-2.0 * np.pi, 2.0 * np.pi, (500, len(rows)))
    assert np.abs(smr_positions(geometry, q) - plant.smr_positions("arm", q)).max() < 1e-12


@pytest.mark.parametrize("axis", ["x", "y", "z", "-x", "-y", "-z"])
def test_an_arm_on_a_wall_or_a_ceiling_stands_where_it_was_put(axis):
    wall = {"x": [0, np.pi / 2, 0], "y": [-np.pi / 2, 0, 0], "z": [0, 0, 0.4], "-x": [0, -np.pi / 2, 0]}
    wall |= {"-y": [np.pi / 2, 0, 0], "-z": [np.pi, 0, 0]}
    T_M_B = transform(rotation_from_vector(wall[axis]), [2.0, -1.0, 0.7])
    geometry = nominal_geometry(UR10, OFF_AXIS, T_M_B)
    np.testing.assert_allclose(geometry.T_M_B(), T_M_B, atol=1e-12)
    assert np.abs(geometry.base).max() < 4.0


def test_the_first_frame_is_the_base_and_the_last_the_flange():
    geometry = at_station(UR5, OFF_AXIS)
    q = np.random.default_rng(0).uniform(-3, 3, (7, 6))
    rotations, origins = frame_poses(geometry, q)
    np.testing.assert_allclose(rotations[0], np.broadcast_to(STATION[:3, :3], (7, 3, 3)), atol=1e-13)
    np.testing.assert_allclose(origins[0], np.broadcast_to(STATION[:3, 3], (7, 3)), atol=1e-13)
    np.testing.assert_allclose(origins[-1] + rotations[-1] @ OFF_AXIS, smr_positions(geometry, q), atol=1e-13)


def test_parallel_axes_of_a_ur_are_those_of_joints_2_and_3():
    assert parallel_rows(at_station(UR10, OFF_AXIS)) == (1, 2)
    assert parallel_rows(at_station(SEVEN, OFF_AXIS)) == ()
