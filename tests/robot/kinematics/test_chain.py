"""The chain against a plain product of matrices, against differences, and against the plant's axes in space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.robot.kinematics.chain import (
    Geometry,
    JointAngles,
    flange_poses,
    frame_poses,
    jacobian,
    nominal_geometry,
    parameter_names,
    smr_positions,
)
from cellapp.robot.kinematics.inverse import all_branches, closed_form_solutions, shifted_into, solve_pose, structure_of
from cellapp.robot.kinematics.statics import Bodies, gravity_loads
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
    ON_AXIS,
    SEVEN,
    UR5,
    UR5_CENTERS,
    UR5_MASSES,
    UR10,
    UR10_CENTERS,
    UR10_MASSES,
    at_station,
    plant_of,
    true_geometry,
)
from tests.sure import sure

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
@settings(max_examples=60)
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
@settings(max_examples=40)
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


@pytest.mark.parametrize("rows", [UR10, UR5, SEVEN], ids=["UR10", "UR5", "seven joints"])
def test_the_plant_agrees_when_all_its_errors_are_off(rows):
    geometry, plant = at_station(rows, OFF_AXIS), plant_of(rows, OFF_AXIS)
    q = np.random.default_rng(3).uniform(-2.0 * np.pi, 2.0 * np.pi, (500, len(rows)))
    assert np.abs(smr_positions(geometry, q) - plant.smr_positions("arm", q)).max() < 1e-12


# -- Rotations, registration -------------------------------------------------------------------------------------------

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


@pytest.mark.parametrize("y", [np.pi / 2.0, -np.pi / 2.0, np.pi / 2.0 - 1e-11, 1e-9 - np.pi / 2.0])
def test_zyx_angles_at_gimbal_lock_give_the_same_rotation(y):
    rotation = rotation_zyx(0.4, y, -1.1)
    np.testing.assert_allclose(rotation_zyx(*zyx_angles(rotation)), rotation, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50)
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


# -- The inverse: every solution, from near by and from any rotation ---------------------------------------------------


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
    assert found.residual_m[0] > 1.0


@pytest.mark.parametrize("max_iterations", [1, 60])  # 1: the start alone
def test_a_flange_half_a_turn_off_does_not_count_as_reached(max_iterations):
    """The SMR lies on the last axis: half a turn of the last joint keeps its position and reverses the flange."""
    geometry = at_station(UR10, ON_AXIS)
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (20, 6))
    start = q + np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.pi])
    wanted, (rotation, _) = smr_positions(geometry, q), flange_poses(geometry, q)
    found = solve_pose(geometry, wanted, rotation, start, max_iterations=max_iterations)
    reversed_flange = np.einsum("nab,nab->n", flange_poses(geometry, found.q)[0], rotation) < 0.0
    assert not found.reached[reversed_flange].any()
    np.testing.assert_allclose(found.residual_rad[reversed_flange], np.pi, atol=1e-6)
    if max_iterations > 1:
        assert found.reached.mean() > 0.9


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8]], ids=str)
def test_a_wanted_rotation_half_a_turn_from_the_start_is_solved_or_reported(axis):
    geometry = at_station(UR10, OFF_AXIS)
    q = np.random.default_rng(2).uniform(-1.5, 1.5, (30, 6))
    rotation, wanted = flange_poses(geometry, q)[0], smr_positions(geometry, q)
    rotated = rotation @ rotation_from_vector(np.pi * np.array(axis))
    found = solve_pose(geometry, wanted, rotated, q)
    there = found.q[found.reached]
    np.testing.assert_allclose(flange_poses(geometry, there)[0], rotated[found.reached], atol=1e-9)
    np.testing.assert_allclose(smr_positions(geometry, there), wanted[found.reached], atol=1e-9)
    assert found.reached.mean() > 0.3


# -- All solutions in closed form, judged by forward kinematics and against a search from many starts ------------------

BASE = np.array([0.4, -0.3, 0.2, 0.1, -0.2, 0.7])
TOOL = np.array([0.03, -0.02, 0.11])
H = 0.5 * np.pi
UR = [[*row, 0.0] for row in UR10.tolist()]
OFFSET_PARALLEL = [
    [0.1, 0.1, 0.07, 1.2, 0.0],
    [0.2, 0.05, -0.6, np.pi, 0.0],
    [0.3, -0.03, -0.5, 0.0, 0.0],
    [0.4, 0.2, 0.04, 1.9, 0.0],
    [-0.5, 0.15, 0.0, -1.1, 0.0],
    [0.6, 0.1, 0.0, 0.7, 0.0],
]
ELBOW = [
    [0.0, 0.38, 0.06, -H, 0.0],
    [-H, 0.0, 0.44, np.pi, 0.0],
    [0.0, 0.0, 0.04, -H, 0.0],
    [0.0, -0.42, 0.0, H, 0.0],
    [0.0, 0.0, 0.0, -H, 0.0],
    [0.0, -0.08, 0.0, np.pi, 0.0],
]
OFFSET_ELBOW = [
    [0.1, 0.1, 0.07, 1.2, 0.0],
    [0.2, 0.05, -0.6, 0.0, 0.0],
    [0.3, -0.03, 0.1, 1.3, 0.0],
    [0.4, 0.4, 0.0, 1.9, 0.0],
    [-0.5, 0.0, 0.0, -1.1, 0.0],
    [0.6, 0.1, 0.05, 0.7, 0.0],
]
CHAINS = {"ur": UR, "offset-parallel": OFFSET_PARALLEL, "elbow": ELBOW, "offset-elbow": OFFSET_ELBOW}


def geometry(rows: list[list[float]]) -> Geometry:
    return Geometry(base=BASE, rows=np.array(rows), tool=TOOL)


def assert_there(chain: Geometry, found: np.ndarray, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Assert that all branches (n, B, N) that were found lead to their poses; of which poses (k,) there are some."""
    rows, branch = np.nonzero(np.isfinite(found[:, :, 0]))
    again = found[rows, branch]
    np.testing.assert_allclose(smr_positions(chain, again), position[rows], atol=1e-9)
    np.testing.assert_allclose(flange_poses(chain, again)[0], rotation[rows], atol=1e-9)
    return rows


def posed(chain: Geometry, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return smr_positions(chain, q), flange_poses(chain, q)[0]


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(np.mod(a - b + np.pi, 2.0 * np.pi) - np.pi).max(axis=-1)


@pytest.mark.parametrize("name", CHAINS)
def test_every_solution_reaches_the_pose_and_one_is_where_it_came_from(name: str) -> None:
    chain = geometry(CHAINS[name])
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (500, 6))
    position, rotation = posed(chain, q)
    found = sure(closed_form_solutions(chain, position, rotation))
    assert_there(chain, found, position, rotation)
    assert np.nanmax(np.nanmin(apart(found, q[:, None]), axis=1)) < 1e-6
    assert np.nanmax(np.abs(found)) <= np.pi


@pytest.mark.parametrize("name", CHAINS)
def test_no_solution_is_missing(name: str) -> None:
    chain = geometry(CHAINS[name])
    rng = np.random.default_rng(1)
    q = rng.uniform(-np.pi, np.pi, (6, 6))
    position, rotation = posed(chain, q)
    found = sure(closed_form_solutions(chain, position, rotation))
    starts = rng.uniform(-np.pi, np.pi, (100, 6))
    for k in range(len(q)):
        searched = solve_pose(chain, np.tile(position[k], (100, 1)), np.tile(rotation[k], (100, 1, 1)), starts)
        solutions = searched.q[searched.reached]
        assert len(solutions) > 20
        assert np.nanmin(apart(solutions[:, None], found[k]), axis=1).max() < 1e-5


def test_a_chain_beside_its_structure_is_made_exact() -> None:
    chain = geometry((np.array(UR) + 1e-3 * np.random.default_rng(3).standard_normal((6, 5))).tolist())
    q = np.random.default_rng(4).uniform(-2.5, 2.5, (200, 6))
    position, rotation = posed(chain, q)
    found = sure(closed_form_solutions(chain, position, rotation))
    assert_there(chain, found, position, rotation)
    own = np.nanmin(np.where(np.isnan(found[:, :, :1]), 9.0, apart(found, q[:, None])[:, :, None]), axis=(1, 2))
    assert np.mean(own < 1e-6) > 0.95, "only poses at the border of what can be reached may lose their branch"


def test_poses_out_of_reach_have_no_solution_and_a_free_joint_stands_where_it_is_asked_to() -> None:
    chain = geometry(UR)
    far = sure(closed_form_solutions(chain, np.array([[5.0, 0.0, 0.0]]), np.eye(3)[None]))
    assert np.isnan(far).all()
    q = np.array([[0.3, -1.0, 0.8, -0.7, 0.0, 0.4]])  # axes 4 and 6 are parallel
    near = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.25])
    found = sure(closed_form_solutions(chain, *posed(chain, q), near))
    straight = found[0][np.abs(found[0][:, 4]) < 1e-6]
    assert len(straight)
    np.testing.assert_allclose(straight[:, 5], 0.25, atol=1e-12)


def test_other_chains_have_no_closed_form() -> None:
    rows = np.array(UR)
    rows[1, 3] = 0.5
    assert structure_of(geometry(rows.tolist())) is None
    assert closed_form_solutions(geometry(UR[:5]), np.zeros((1, 3)), np.eye(3)[None]) is None


# -- All branches of chains without a closed form, positions with free rotation, and whole turns within limits ---------

GENERAL = geometry([[0.0, 0.3, 0.1, 1.4, 0.0], [0.0, 0.1, 0.4, 0.3, 0.0], *UR[2:]])
"""Axes 2 and 3 are not parallel: no closed form."""
SEVEN_OF_BRANCHES = geometry([[*row, 0.0] for row in SEVEN.tolist()])
FIVE = replace(GENERAL, rows=GENERAL.rows[:5])
FOUR_TURNS = np.tile([-2.0 * np.pi, 2.0 * np.pi], (7, 1))


def poses(chain: Geometry, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    return posed(chain, np.random.default_rng(seed).uniform(-2.5, 2.5, (n, chain.joints)))


def found_by(chain: Geometry, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    limits = FOUR_TURNS[: chain.joints]
    return all_branches(chain, position, rotation, limits, np.zeros(chain.joints), seed=1)


@pytest.mark.parametrize("chain", [GENERAL, SEVEN_OF_BRANCHES, FIVE], ids=["six", "seven", "five"])
def test_chains_without_a_closed_form_are_solved_from_samples(chain: Geometry) -> None:
    assert structure_of(chain) is None
    position, rotation = poses(chain, 20)
    found = found_by(chain, position, rotation)
    rows = assert_there(chain, found, position, rotation)
    assert len(np.unique(rows)) == 20, "every pose has a solution"
    for one in found:
        kept = one[np.isfinite(one[:, 0])]
        gaps = apart(kept[:, None], kept) + 9.0 * np.eye(len(kept))
        assert gaps.min() > 1e-5, "no solution twice"


@pytest.mark.parametrize("chain", [geometry(UR), SEVEN_OF_BRANCHES, FIVE], ids=["six", "seven", "five"])
def test_positions_with_any_rotation_are_reached_near_the_preferred_configuration(chain: Geometry) -> None:
    position, rotation = poses(chain, 20)
    near = np.full(chain.joints, 0.3)
    found = all_branches(chain, position, rotation * np.nan, FOUR_TURNS[: chain.joints], near, seed=1)
    rows, branch = np.nonzero(np.isfinite(found[:, :, 0]))
    assert len(np.unique(rows)) == 20
    np.testing.assert_allclose(smr_positions(chain, found[rows, branch]), position[rows], atol=1e-8)
    nearest = np.nanmin(np.linalg.norm(found - near, axis=2), axis=1)
    posed = all_branches(chain, position, rotation, FOUR_TURNS[: chain.joints], near, seed=1)
    with_rotation = np.nanmin(
        np.linalg.norm(shifted_into(posed, FOUR_TURNS[: chain.joints], near)[0] - near, axis=2), axis=1
    )
    assert np.mean(nearest <= with_rotation + 1e-6) > 0.9, "freedom is used"


def test_what_is_out_of_reach_has_no_solution() -> None:
    for chain in (GENERAL, SEVEN_OF_BRANCHES):
        far = np.array([[9.0, 0.0, 0.0]])
        assert np.isnan(found_by(chain, far, np.eye(3)[None])).all()
        assert np.isnan(found_by(chain, far, np.full((1, 3, 3), np.nan))).all()
    assert found_by(GENERAL, np.empty((0, 3)), np.empty((0, 3, 3))).shape[0] == 0


@given(st.floats(-20.0, 20.0), st.floats(-7.0, 2.0), st.floats(0.0, 9.0), st.floats(-7.0, 7.0))
def test_whole_turns(q: float, low: float, width: float, to: float) -> None:
    limits = np.array([[low, low + width]])
    rotated, beyond = shifted_into(np.array([[q]]), limits, np.array([to]))
    rotations = (rotated[0, 0] - q) / (2.0 * np.pi)
    assert abs(rotations - round(rotations)) < 1e-9
    every = q + 2.0 * np.pi * np.arange(-6, 7)
    outside = np.maximum(np.maximum(low - every, every - low - width), 0.0)
    assert beyond[0, 0] == pytest.approx(outside.min(), abs=2e-9)
    if beyond[0, 0] == 0.0:
        inside = every[outside == 0.0]
        assert abs(rotated[0, 0] - to) <= np.abs(inside - to).min(initial=np.inf) + 1e-6
