"""All solutions in closed form, judged by forward kinematics and against a search from many starts."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.robot.kinematics.chain import Geometry, flange_poses, smr_positions
from cellapp.robot.kinematics.inverse import closed_form_solutions, solve_pose, structure_of

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
