"""Inverse kinematics on arms whose axes are nowhere exactly parallel or crossing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.robot.kinematics.chain import Geometry, flange_poses, smr_positions
from cellapp.robot.kinematics.inverse import all_branches, closed_form_solutions, solve_pose, structure_of, turned_into
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


# -- All solutions in closed form, judged by forward kinematics and against a search from many starts ------------------

BASE = np.array([0.4, -0.3, 0.2, 0.1, -0.2, 0.7])
TOOL = np.array([0.03, -0.02, 0.11])
H = 0.5 * np.pi
UR = [
    [0.0, 0.1273, 0.0, H, 0.0],
    [0.0, 0.0, -0.612, 0.0, 0.0],
    [0.0, 0.0, -0.5723, 0.0, 0.0],
    [0.0, 0.163941, 0.0, H, 0.0],
    [0.0, 0.1157, 0.0, -H, 0.0],
    [0.0, 0.0922, 0.0, 0.0, 0.0],
]
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


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(np.mod(a - b + np.pi, 2.0 * np.pi) - np.pi).max(axis=-1)


@pytest.mark.parametrize("name", CHAINS)
def test_every_solution_reaches_the_pose_and_one_is_where_it_came_from(name: str) -> None:
    chain = geometry(CHAINS[name])
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (500, 6))
    rotation, _ = flange_poses(chain, q)
    position = smr_positions(chain, q)
    found = closed_form_solutions(chain, position, rotation)
    assert found is not None
    rows, branch = np.nonzero(np.isfinite(found[:, :, 0]))
    again = found[rows, branch]
    np.testing.assert_allclose(smr_positions(chain, again), position[rows], atol=1e-9)
    np.testing.assert_allclose(flange_poses(chain, again)[0], rotation[rows], atol=1e-9)
    assert np.nanmax(np.nanmin(apart(found, q[:, None]), axis=1)) < 1e-6
    assert np.abs(again).max() <= np.pi


@pytest.mark.parametrize("name", CHAINS)
def test_no_solution_is_missing(name: str) -> None:
    chain = geometry(CHAINS[name])
    rng = np.random.default_rng(1)
    q = rng.uniform(-np.pi, np.pi, (6, 6))
    rotation, _ = flange_poses(chain, q)
    position = smr_positions(chain, q)
    found = closed_form_solutions(chain, position, rotation)
    assert found is not None
    starts = rng.uniform(-np.pi, np.pi, (100, 6))
    for k in range(len(q)):
        searched = solve_pose(chain, np.tile(position[k], (100, 1)), np.tile(rotation[k], (100, 1, 1)), starts)
        solutions = searched.q[searched.reached]
        assert len(solutions) > 20
        assert np.nanmin(apart(solutions[:, None], found[k]), axis=1).max() < 1e-5


def test_a_chain_beside_its_structure_is_made_exact() -> None:
    chain = geometry((np.array(UR) + 1e-3 * np.random.default_rng(3).standard_normal((6, 5))).tolist())
    q = np.random.default_rng(4).uniform(-2.5, 2.5, (200, 6))
    rotation, _ = flange_poses(chain, q)
    position = smr_positions(chain, q)
    found = closed_form_solutions(chain, position, rotation)
    assert found is not None
    rows, branch = np.nonzero(np.isfinite(found[:, :, 0]))
    np.testing.assert_allclose(smr_positions(chain, found[rows, branch]), position[rows], atol=1e-9)
    own = np.nanmin(np.where(np.isnan(found[:, :, :1]), 9.0, apart(found, q[:, None])[:, :, None]), axis=(1, 2))
    assert np.mean(own < 1e-6) > 0.95, "only poses at the border of what can be reached may lose their branch"


def test_poses_out_of_reach_have_no_solution_and_a_free_joint_stands_where_it_is_asked_to() -> None:
    chain = geometry(UR)
    far = closed_form_solutions(chain, np.array([[5.0, 0.0, 0.0]]), np.eye(3)[None])
    assert far is not None
    assert np.isnan(far).all()
    q = np.array([[0.3, -1.0, 0.8, -0.7, 0.0, 0.4]])  # axes 4 and 6 are parallel
    near = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.25])
    found = closed_form_solutions(chain, smr_positions(chain, q), flange_poses(chain, q)[0], near)
    assert found is not None
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
SEVEN_OF_BRANCHES = geometry(
    [
        [0.0, 0.34, 0.0, -H, 0.0],
        [0.0, 0.0, 0.0, H, 0.0],
        [0.0, 0.4, 0.0, H, 0.0],
        [0.0, 0.0, 0.0, -H, 0.0],
        [0.0, 0.4, 0.0, -H, 0.0],
        [0.0, 0.0, 0.0, H, 0.0],
        [0.0, 0.126, 0.0, 0.0, 0.0],
    ]
)
FIVE = replace(GENERAL, rows=GENERAL.rows[:5])
FOUR_TURNS = np.tile([-2.0 * np.pi, 2.0 * np.pi], (7, 1))


def poses(chain: Geometry, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    q = np.random.default_rng(seed).uniform(-2.5, 2.5, (n, chain.joints))
    return smr_positions(chain, q), flange_poses(chain, q)[0]


def found_by(chain: Geometry, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    limits = FOUR_TURNS[: chain.joints]
    return all_branches(chain, position, rotation, limits, np.zeros(chain.joints), seed=1)


@pytest.mark.parametrize("chain", [GENERAL, SEVEN_OF_BRANCHES, FIVE], ids=["six", "seven", "five"])
def test_chains_without_a_closed_form_are_solved_from_samples(chain: Geometry) -> None:
    assert structure_of(chain) is None
    position, rotation = poses(chain, 20)
    found = found_by(chain, position, rotation)
    rows, branch = np.nonzero(np.isfinite(found[:, :, 0]))
    assert len(np.unique(rows)) == 20, "every pose has a solution"
    again = found[rows, branch]
    np.testing.assert_allclose(smr_positions(chain, again), position[rows], atol=1e-9)
    np.testing.assert_allclose(flange_poses(chain, again)[0], rotation[rows], atol=1e-9)
    for one in found:
        kept = one[np.isfinite(one[:, 0])]
        gaps = apart(kept[:, None], kept) + 9.0 * np.eye(len(kept))
        assert gaps.min() > 1e-5, "no solution twice"


def test_samples_find_nearly_all_branches_of_a_general_arm() -> None:
    position, rotation = poses(GENERAL, 8, seed=2)
    found = found_by(GENERAL, position, rotation)
    starts = np.random.default_rng(3).uniform(-np.pi, np.pi, (200, 6))
    known = missing = 0
    for k in range(8):
        searched = solve_pose(GENERAL, np.tile(position[k], (200, 1)), np.tile(rotation[k], (200, 1, 1)), starts)
        gaps = np.nanmin(apart(searched.q[searched.reached][:, None], found[k]), axis=1)
        known, missing = known + len(gaps), missing + int(np.count_nonzero(gaps > 1e-4))
    assert known > 200
    assert missing < 0.1 * known


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
        np.linalg.norm(turned_into(posed, FOUR_TURNS[: chain.joints], near)[0] - near, axis=2), axis=1
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
    turned, beyond = turned_into(np.array([[q]]), limits, np.array([to]))
    turns = (turned[0, 0] - q) / (2.0 * np.pi)
    assert abs(turns - round(turns)) < 1e-9
    every = q + 2.0 * np.pi * np.arange(-6, 7)
    outside = np.maximum(np.maximum(low - every, every - low - width), 0.0)
    assert beyond[0, 0] == pytest.approx(outside.min(), abs=2e-9)
    if beyond[0, 0] == 0.0:
        inside = every[outside == 0.0]
        assert abs(turned[0, 0] - to) <= np.abs(inside - to).min(initial=np.inf) + 1e-6
