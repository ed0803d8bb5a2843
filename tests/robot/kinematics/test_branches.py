"""All branches of chains without a closed form, positions with free rotation, and whole turns within limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.robot.kinematics.chain import Geometry, flange_poses, smr_positions
from cellapp.robot.kinematics.inverse import all_branches, solve_pose, structure_of, turned_into
from tests.robot.kinematics.test_closed_form import UR, apart, geometry

H = 0.5 * np.pi
GENERAL = geometry([[0.0, 0.3, 0.1, 1.4, 0.0], [0.0, 0.1, 0.4, 0.3, 0.0], *UR[2:]])
"""Axes 2 and 3 are not parallel: no closed form."""
SEVEN = geometry(
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


@pytest.mark.parametrize("chain", [GENERAL, SEVEN, FIVE], ids=["six", "seven", "five"])
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


@pytest.mark.parametrize("chain", [geometry(UR), SEVEN, FIVE], ids=["six", "seven", "five"])
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
    for chain in (GENERAL, SEVEN):
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
