"""The pool of candidates: usable, spread like plain rejection, by seed; an impossible cell names its constraint."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import ks_2samp

from cellapp.cell.planning.candidates import (
    CandidatePool,
    draw_joints,
    draw_pool,
    exclusions,
    joint_ranges,
    random_configurations,
    workspace_configurations,
)
from cellapp.cell.planning.designed import design_stops, free_ways, hubs_of, within_reach
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.bodies import ArmBodies, place
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, clear_alone, refuse_motion, visible
from cellapp.cell.safety.visibility import TrackerField, sight_of
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import BoxObstacle, Placement
from cellapp.ground.progress import Cancelled, CancelToken
from cellapp.robot.kinematics.chain import nominal_geometry
from cellapp.robot.kinematics.transforms import transform
from tests.twin import PROFILES, small_twin, with_arms

COUNT = 400
FACING = math.radians(20.0)
TRACKER = TrackerField(
    transform(np.diag([-1.0, -1.0, 1.0]), np.array([3.5, 0.3, 0.5])), (-7.0, 7.0), (-0.9, 0.9), (1.0, 40.0)
)
HALF_TURN = 0.5 * math.pi


def chain_cell(rows: list[list[float]], normal: tuple[float, float, float]) -> CellBodies:
    """A cell of one arm 'only' with a capsule along every link, at the origin before the tracker."""
    table = np.array(rows)
    links = np.arange(1, len(table) + 1)
    back = np.array([[-a, -d * math.sin(alpha), -d * math.cos(alpha)] for _, d, a, alpha in rows])
    arm = ArmBodies(
        geometry=nominal_geometry(table, np.array([0.02, 0.01, 0.05]), np.eye(4)),
        frames=links,
        start=np.zeros((len(table), 3)),
        end=back,
        radius=np.full(len(table), 0.04),
        limits=np.tile([-2.9, 2.9], (len(table), 1)),
        normal_F=np.array(normal),
        acceptance=0.5,
    )
    return CellBodies({"only": arm}, TRACKER, 0.05, -1.0)


def turned_smr(normal: tuple[float, float, float]) -> CellBodies:
    cell = cell_bodies(small_twin())
    arms = {name: dataclasses.replace(arm, normal_F=np.array(normal)) for name, arm in cell.arms.items()}
    return dataclasses.replace(cell, arms=arms)


FOUR = [
    [0.0, 0.4, 0.0, HALF_TURN],
    [0.0, 0.0, 0.5, 0.0],
    [0.0, 0.0, 0.4, HALF_TURN],
    [0.0, 0.1, 0.0, 0.0],
]
CELLS: dict[str, tuple[CellBodies, str]] = {
    "UR10": (cell_bodies(small_twin()), "left"),
    "UR5": (cell_bodies(small_twin()), "right"),
    "SMR across the flange axis": (turned_smr((1.0, 0.0, 0.0)), "left"),
    "oblique SMR": (turned_smr((0.6, 0.0, 0.8)), "right"),
    "seven joints": (cell_bodies(load_profile(PROFILES / "twin-foreign.yaml")), "seven"),
    "four joints": (chain_cell(FOUR, (0.0, 0.0, 1.0)), "only"),
    "two joints": (chain_cell(FOUR[1:3], (1.0, 0.0, 0.0)), "only"),
    "one joint": (chain_cell(FOUR[:1], (1.0, 0.0, 0.0)), "only"),
}


def pool_of(cell: CellBodies, name: str, seed: int = 3, count: int = COUNT, **plan: Any) -> CandidatePool:
    return draw_pool(cell, small_twin(COUNT, plan=plan), name, count, np.random.default_rng(seed))


def plain_rejection(cell: CellBodies, name: str, draws: int) -> np.ndarray:
    low, high = joint_ranges(cell, small_twin(), name).T
    q = np.random.default_rng(77).uniform(low, high, (draws, len(low)))
    q = q[visible(cell, name, q)]
    return np.asarray(q[clear_alone(cell, place(cell.arms[name], q))])


@pytest.mark.parametrize("which", CELLS)
def test_every_candidate_can_be_measured(which: str) -> None:
    cell, name = CELLS[which]
    arm, pool = cell.arms[name], pool_of(cell, name)
    assert pool.q.shape == (COUNT, arm.geometry.joints)
    assert np.all((pool.q >= arm.limits[:, 0]) & (pool.q <= arm.limits[:, 1]))
    placed = place(arm, pool.q)
    assert visible(cell, name, pool.q).all()
    assert clear_alone(cell, placed).all()
    assert len(np.unique(pool.q, axis=0)) == COUNT
    assert cell.field is not None
    np.testing.assert_allclose(pool.incidence, sight_of(cell.field.T_C_M, placed).incidence, atol=1e-7)
    assert pool.drawn - sum(pool.rejected.values()) >= COUNT
    assert pool.rejected["gate"] == 0, "the named constraints are all that the gate asks for"


@pytest.mark.parametrize("which", ["UR10", "SMR across the flange axis", "four joints"])
def test_each_joint_is_spread_like_plain_rejection(which: str) -> None:
    """Kolmogorov-Smirnov: without a preference for small incidence, both are draws from one distribution."""
    cell, name = CELLS[which]
    expected = plain_rejection(cell, name, 120_000)
    found = pool_of(cell, name, count=3000, incidence=HALF_TURN).q
    for j in range(found.shape[1]):
        assert ks_2samp(found[:, j], expected[:, j]).pvalue > 1e-3, f"joint {j + 1}"
    for i, k in ((0, -1), (1, -1), (0, 1)):  # sums of first joints and wrist: their combinations too
        assert ks_2samp(found[:, i] + found[:, k], expected[:, i] + expected[:, k]).pvalue > 1e-3


def test_small_incidence_is_preferred_and_no_joint_loses_its_range() -> None:
    cell, name = CELLS["UR10"]
    plain, pool = plain_rejection(cell, name, 120_000), pool_of(cell, name, count=4000)
    assert cell.field is not None
    before = np.mean(sight_of(cell.field.T_C_M, place(cell.arms[name], plain)).incidence <= FACING)
    after = np.mean(pool.incidence <= FACING)
    assert before < 0.65
    assert 0.8 < after < 0.95, "some are left for effects of the incidence"
    for level in (0.02, 0.98):
        np.testing.assert_allclose(np.quantile(pool.q, level, axis=0), np.quantile(plain, level, axis=0), atol=0.25)


def test_random_configurations_are_independent() -> None:
    cell, name = CELLS["UR10"]
    configurations = random_configurations(cell, small_twin(), name, np.random.default_rng(5))
    q = np.array([next(configurations) for _ in range(600)])
    for j in range(6):
        assert len(np.unique(q[:, j])) == 600
    assert visible(cell, name, q).all()


def test_the_seed_makes_the_pool() -> None:
    cell, name = CELLS["UR10"]
    first, again, other = (pool_of(cell, name, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.q, again.q)
    assert (first.drawn, first.rejected) == (again.drawn, again.rejected)
    assert not np.any(np.all(first.q == other.q, axis=1))


def test_joints_that_may_not_move_give_no_copies() -> None:
    cell, name = CELLS["UR10"]
    start = pool_of(cell, name).q[0]
    free = (tuple((value, value) for value in start[:3]), tuple((value - 0.3, value + 0.3) for value in start[3:]))
    for ranges in ((*free[0], *free[1]), (*((v - 0.3, v + 0.3) for v in start[:3]), *((v, v) for v in start[3:]))):
        q = pool_of(cell, name, count=100, ranges=ranges).q
        assert len(np.unique(q, axis=0)) == 100


def test_a_pool_may_be_smaller_than_asked_for_but_not_than_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.cell.planning.candidates._MOST_DRAWS", 60_000)
    monkeypatch.setattr("cellapp.cell.planning.candidates._MOST_DRAWS_PER_CANDIDATE", 1)
    cell, name = CELLS["UR10"]
    assert COUNT <= len(pool_of(cell, name, count=5000).q) < 5000
    with pytest.raises(InputError, match=rf"[0-9]+ of [0-9]+ random .* can be measured, {COUNT * 10} are needed"):
        draw_pool(cell, small_twin(COUNT * 10), name, 5000, np.random.default_rng(0))


def test_drawing_can_be_cancelled() -> None:
    token = CancelToken()
    token.cancel()
    with pytest.raises(Cancelled):
        draw_pool(*CELLS["UR10"][:1], small_twin(), "left", 10, np.random.default_rng(0), token)


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), which=st.sampled_from(sorted(CELLS)))
def test_what_is_seen_of_combined_joints_is_what_placing_them_gives(seed: int, which: str) -> None:
    cell, name = CELLS[which]
    arm = cell.arms[name]
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T_C_M = transform(rotation * np.sign(np.linalg.det(rotation)), rng.normal(size=3) * 3.0)
    draws = draw_joints(arm, T_C_M, arm.limits, rng)
    chosen = rng.random(draws.sight.distance.shape) < 0.01
    expected = sight_of(T_C_M, place(arm, draws.q(chosen)))
    np.testing.assert_allclose(draws.sight.smr_M[:, chosen], expected.smr_M, atol=1e-12)
    np.testing.assert_allclose(draws.sight.distance[chosen], expected.distance, atol=1e-12)
    np.testing.assert_allclose(draws.sight.cosine[chosen], expected.cosine, atol=1e-9)


# -- cells in which nothing can be measured ---------------------------------------------------------------------------


def with_tracker(profile: Profile, **changes: Any) -> Profile:
    return profile.model_copy(update={"tracker": profile.tracker.model_copy(update=changes)})


def with_plan(profile: Profile, **changes: Any) -> Profile:
    return profile.model_copy(update={"plan": profile.plan.model_copy(update=changes)})


def with_box(profile: Profile, position: tuple[float, float, float], size: tuple[float, float, float]) -> Profile:
    box = BoxObstacle(shape="box", size=size, pose=Placement(position=position))
    return profile.model_copy(update={"obstacles": {"table": box}})


def folded(profile: Profile) -> Profile:
    """The forearm may only lie on the upper arm."""
    limits = tuple((2.9, 3.1) if joint == 2 else (-3.0, 3.0) for joint in range(6))
    return with_arms(with_plan(profile, floor=-3.0), limits=limits)


def impossible(twin: Profile) -> dict[str, tuple[Profile, str, str]]:
    """Cause -> profile, the constraint, what its extent says."""
    smr, no_home = twin.arms["left"].smr, with_arms(twin, home=None)
    return {
        "too far": (with_tracker(twin, distance=(6.0, 40.0)), "range", r"allowed are 6 to 40 m; .* by [0-9]+ mm"),
        "behind its back": (with_tracker(twin, azimuth=(2.8, 3.4)), "azimuth", r"allowed are 160\.4 to 194\.8 deg"),
        "too high": (with_tracker(twin, elevation=(1.0, 1.5)), "elevation", r"seen at -1[0-9] to 1[0-9] deg, .* deg"),
        "looking back": (
            with_arms(twin, smr=smr.model_copy(update={"normal": (0.0, 0.0, -1.0), "acceptance": 0.05})),
            "facing",
            "looks away from the tracker; the nearest misses by [0-9]+ deg",
        ),
        "floor": (with_plan(twin, floor=0.5), "floor", "nearest misses by [0-9]+ mm"),
        "ceiling": (with_plan(twin, ceiling=-0.1, floor=-3.0), "ceiling", "nearest misses by [0-9]+ mm"),
        "wall": (with_box(twin, (2.0, 0.0, 0.5), (0.1, 9.0, 9.0)), "obstacle 'table' in the beam", "nearest misses by"),
        "in a box": (with_box(no_home, (0.0, 0.85, 0.3), (0.3, 0.3, 0.3)), "obstacle 'table'", "nearest misses by"),
        "folded": (folded(twin), "own bodies", "nearest misses by [0-9]+ mm"),
    }


CAUSES = impossible(small_twin(3))


@pytest.mark.parametrize("cause", CAUSES)
def test_what_cannot_be_measured_names_its_constraint(cause: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.cell.planning.candidates._MOST_DRAWS", 20_000)
    profile, constraint, extent = CAUSES[cause]
    cell = cell_bodies(profile)
    first = exclusions(cell, profile, "left")[0]
    assert first.constraint == constraint
    assert first.alone > 0.99
    with pytest.raises(InputError, match=f"arm left: none of [0-9]+ random .*: .*{extent}.* What helps: ") as told:
        draw_pool(cell, profile, "left", 10, np.random.default_rng(0))
    assert first.advice in str(told.value)


# -- Points of the workspace: clear, inside the ranges, seen by the tracker or not -------------------------------------


def test_targets_are_clear_wherever_the_smr_looks() -> None:
    profile = small_twin()
    cell = cell_bodies(profile)
    q = workspace_configurations(profile, cell, "left", 200, np.random.default_rng(5))
    assert q.shape == (200, 6)
    assert clear_alone(cell, place(cell.arms["left"], q)).all()
    assert visible(cell, "left", q).mean() < 0.2
    again = workspace_configurations(profile, cell, "left", 200, np.random.default_rng(5))
    np.testing.assert_array_equal(q, again)


# -- Candidates within easy reach: what lies behind a wall that no way passes is none, and free ways are free ----------


def test_free_ways_agree_with_finely_placed_bodies() -> None:
    profile = small_twin()
    cell, home = cell_bodies(profile), home_positions(profile)["left"]
    q = draw_pool(cell, profile, "left", 60, np.random.default_rng(4)).q
    free = free_ways(cell, "left", home, q)
    shares = np.linspace(0.0, 1.0, 12)[1:-1]
    for row, found in zip(q, free, strict=True):
        at = home + shares[:, None] * (row - home)
        assert found == clear_alone(cell, place(cell.arms["left"], at)).all()


def test_poses_beyond_a_locked_range_are_out_of_reach() -> None:
    """The real cell's joint limits leave pockets: those within reach have straight ways that the gate accepts."""
    profile = load_profile(PROFILES / "ur10-ur5.yaml")
    cell, homes = cell_bodies(profile), home_positions(profile)
    q = draw_pool(cell, profile, "right", 300, np.random.default_rng(2)).q
    reached = within_reach(cell, "right", q, hubs_of(cell, "right", q, homes["right"]))
    assert 0.5 < reached.mean() < 0.98
    alone = replace(cell, arms={"right": cell.arms["right"]})

    def ways(rows: np.ndarray) -> float:
        hubs = np.vstack([homes["right"][None], q[reached][:8]])
        free = [[not refuse_motion(alone, {"right": hub}, {"right": row}) for hub in hubs] for row in rows]
        return float(np.mean(free))

    assert ways(q[reached][8:28]) > 2.0 * ways(q[~reached][:20])


def test_a_design_is_the_same_by_seed_and_keeps_what_it_is_given() -> None:
    profile = small_twin(12, plan={"candidates": 200})
    first, again = design_stops(profile, 12), design_stops(profile, 12)
    other = design_stops(profile.model_copy(update={"seed": 8}), 12)
    for name, q in first.stops.q.items():
        np.testing.assert_array_equal(q, again.stops.q[name])
        assert not np.array_equal(q, other.stops.q[name])
    longer = design_stops(profile, 3, kept=first.stops)
    assert len(longer.stops) == 15
    for name, q in first.stops.q.items():
        np.testing.assert_array_equal(longer.stops.q[name][:12], q)
        np.testing.assert_array_equal(longer.stops.approach_from[name][:12], first.stops.approach_from[name])
    assert longer.stops.block[12:].min() > first.stops.block.max()
    assert all(pool.rejected for pool in first.pools.values())
