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
from cellapp.robot.kinematics.statics import STANDARD_GRAVITY, Bodies, base_moment, gravity_loads
from cellapp.robot.kinematics.transforms import (
    apply,
    invert,
    register,
    rotation_from_vector,
    rotation_vectors,
    rotation_x,
    rotation_y,
    rotation_z,
    rotation_zyx,
    transform,
    zyx_angles,
)
from tests.arms import (
    OFF_AXIS,
    SEVEN,
    STATION,
    UR5,
    UR5_CENTERS,
    UR5_MASSES,
    UR10,
    UR10_CENTERS,
    UR10_MASSES,
    at_station,
    plant_of,
)

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


# -- Rotations, registration -------------------------------------------------------------------------------------------

angles = st.floats(-3.0, 3.0)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_zyx_angles_are_read_back(z, y, x):
    np.testing.assert_allclose(rotation_zyx(*zyx_angles(rotation_zyx(z, y, x))), rotation_zyx(z, y, x), atol=1e-12)


@given(st.tuples(*[st.floats(-1.7, 1.7)] * 3))
def test_rotation_vectors_are_read_back(vector):
    np.testing.assert_allclose(rotation_vectors(rotation_from_vector(vector)[None])[0], vector, atol=1e-9)


AXES = np.array(
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.6, -0.8, 0.0], [-1.0, 2.0, 2.0], [3.0, 1.0, -2.0]]
)


@pytest.mark.parametrize("axis", AXES, ids=str)
@pytest.mark.parametrize("short_of_pi", [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1])
def test_rotation_vectors_near_half_a_turn(axis, short_of_pi):
    angle = np.pi - short_of_pi
    rotation = rotation_from_vector(angle * axis / np.linalg.norm(axis))
    (found,) = rotation_vectors(rotation[None])
    assert np.linalg.norm(found) == pytest.approx(angle, abs=1e-9)
    np.testing.assert_allclose(rotation_from_vector(found), rotation, atol=1e-9)


def test_half_a_turn_written_as_a_matrix_has_length_pi():
    flips = np.array([np.diag(signs) for signs in ([1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0])])
    np.testing.assert_allclose(np.abs(rotation_vectors(flips)), np.pi * np.eye(3), atol=1e-12)
    assert rotation_vectors(np.zeros((0, 3, 3))).shape == (0, 3)


def test_small_rotations_keep_their_digits():
    vector = np.array([3e-11, -4e-11, 1e-13])
    np.testing.assert_allclose(rotation_vectors(rotation_from_vector(vector)[None])[0], vector, rtol=1e-9)


@pytest.mark.parametrize("y", [np.pi / 2.0, -np.pi / 2.0, np.pi / 2.0 - 1e-11, 1e-9 - np.pi / 2.0])
def test_zyx_angles_at_gimbal_lock_give_the_same_rotation(y):
    rotation = rotation_zyx(0.4, y, -1.1)
    np.testing.assert_allclose(rotation_zyx(*zyx_angles(rotation)), rotation, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_registration_finds_the_pose_and_never_a_mirror(seed):
    rng = np.random.default_rng(seed)
    T = transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))
    p = rng.normal(size=(5, 3))
    found = register(apply(T, p), p)
    np.testing.assert_allclose(found, T, atol=1e-9)
    mirrored = register(apply(T, p) * [1, 1, -1], p)
    assert np.linalg.det(mirrored[:3, :3]) > 0.0
    np.testing.assert_allclose(invert(T) @ T, np.eye(4), atol=1e-12)


# -- Gravity torques against published sizes, against the gradient of the potential, and against the plant -------------

UP = np.array([0.0, 0.0, 1.0])


def bodies(masses, centers, payload=0.0):
    return Bodies(masses, centers, payload, np.array([0.0, 0.0, 0.08]))


def gravity_torques(geometry, hanging, q, up, payload_kg=None):
    return gravity_loads(frame_poses(geometry, q), hanging, up, payload_kg).joint_torques()


@pytest.mark.parametrize(
    ("rows", "hanging", "published"),
    [
        (UR10, bodies(UR10_MASSES, UR10_CENTERS), [122.0, 41.0, 3.0]),
        (UR10, bodies(UR10_MASSES, UR10_CENTERS, 10.0), [257.0, 117.0, 23.0]),
        (UR5, bodies(UR5_MASSES, UR5_CENTERS), [55.0, 17.0, 1.5]),
        (UR5, bodies(UR5_MASSES, UR5_CENTERS, 5.0), [104.0, 45.0, 10.0]),
    ],
    ids=["UR10", "UR10 with 10 kg", "UR5", "UR5 with 5 kg"],
)
def test_largest_torques_are_the_published_ones(rows, hanging, published):
    # computed from the makers' tables by others, given to the newton metre; the load 80 mm in front of the flange
    geometry = at_station(rows, OFF_AXIS, np.eye(4))
    grid = np.deg2rad(np.arange(-180, 180, 15.0))
    q2, q3, q4 = np.meshgrid(grid, grid, grid, indexing="ij")
    q = np.zeros((q2.size, 6))
    q[:, 1], q[:, 2], q[:, 3] = q2.ravel(), q3.ravel(), q4.ravel()
    largest = np.zeros(3)
    for q5 in (0.0, np.pi / 2.0):
        q[:, 4] = q5
        largest = np.maximum(largest, np.abs(gravity_torques(geometry, hanging, q, UP)[:, 1:4]).max(axis=0))
    np.testing.assert_allclose(largest, published, rtol=0.02, atol=0.6)


def test_torque_is_the_falling_slope_of_the_potential():
    rng = np.random.default_rng(0)
    geometry, hanging = at_station(UR10, OFF_AXIS), bodies(UR10_MASSES, UR10_CENTERS, 4.0)
    up = np.array([0.1, -0.2, 0.97])
    up /= np.linalg.norm(up)
    q = rng.uniform(-3, 3, (20, 6))

    def potential(q):
        rotations, origins = frame_poses(geometry, q)
        heights = (origins[1:] + np.einsum("inab,ib->ina", rotations[1:], hanging.centers)) @ up
        load = (origins[-1] + rotations[-1] @ hanging.payload_center) @ up
        return STANDARD_GRAVITY * (hanging.masses @ heights + hanging.payload_mass * load)

    torques = gravity_torques(geometry, hanging, q, up)
    for j in range(6):
        step = np.zeros(6)
        step[j] = 1e-5
        np.testing.assert_allclose(torques[:, j], -(potential(q + step) - potential(q - step)) / 2e-5, atol=1e-6)


def test_a_payload_per_reading_replaces_the_stated_one():
    geometry, hanging = at_station(UR10, OFF_AXIS, np.eye(4)), bodies(UR10_MASSES, UR10_CENTERS, 2.0)
    q = np.random.default_rng(1).uniform(-3, 3, (3, 6))
    given_loads = gravity_torques(geometry, hanging, q, UP, np.array([np.nan, 2.0, 0.0]))
    stated = gravity_torques(geometry, hanging, q, UP)
    np.testing.assert_allclose(given_loads[:2], stated[:2], atol=1e-12)
    np.testing.assert_allclose(
        given_loads[2], gravity_torques(geometry, bodies(UR10_MASSES, UR10_CENTERS), q, UP)[2], atol=1e-12
    )


def test_torques_of_single_masses_sum_to_the_joint_torques():
    geometry, hanging = at_station(UR10, OFF_AXIS), bodies(UR10_MASSES, UR10_CENTERS, 4.0)
    q = np.random.default_rng(2).uniform(-3, 3, (8, 6))
    loads = gravity_loads(frame_poses(geometry, q), hanging, UP)
    np.testing.assert_allclose(sum(loads.torques_of(k) for k in range(7)), loads.joint_torques(), atol=1e-9)
    np.testing.assert_array_equal(loads.torques_of(6), loads.torques_of(-1))
    assert not loads.torques_of(2)[:, 3:].any(), "body 3 is before joint 4"


def test_the_moment_beyond_a_frame_gives_the_torque_of_its_joint():
    geometry, hanging = at_station(UR10, OFF_AXIS), bodies(UR10_MASSES, UR10_CENTERS, 4.0)
    q = np.random.default_rng(3).uniform(-3, 3, (8, 6))
    loads = gravity_loads(frame_poses(geometry, q), hanging, UP)
    for j in range(6):
        force, moment = loads.beyond(j)
        axis = loads.rotations[j][:, :, 2]
        np.testing.assert_allclose(np.einsum("na,na->n", axis, moment), loads.joint_torques()[:, j], atol=1e-9)
        carried = hanging.masses[j:].sum() + hanging.payload_mass
        np.testing.assert_allclose(force, np.tile(-STANDARD_GRAVITY * carried * UP, (8, 1)))
    np.testing.assert_array_equal(base_moment(geometry, hanging, q, UP), loads.beyond(0)[1])
