"""Planned sequences: the gate accepts every motion, factors correlate with nothing, less travel than by chance."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise, permutations, product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.optimize import lsq_linear

from cellapp.cell.planning.arrangement import StopSet, arrange
from cellapp.cell.planning.balance import correlations, standardised, travel_time
from cellapp.cell.planning.duration import motion_s, route_s, stop_times_of
from cellapp.cell.planning.plan import draw_stops
from cellapp.cell.planning.planned_stops import PlannedStops, straight_stops
from cellapp.cell.planning.sequence import Sequenced, distinct_stops, nearest_turns, repair_order, sequenced
from cellapp.cell.planning.transit_paths import (
    ArmRoadmap,
    Move,
    TourTask,
    TransitPath,
    TransitPlanner,
    best_order,
)
from cellapp.cell.safety.bodies import place, segment_distance
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_motion, visible_stops
from cellapp.cell.safety.many_motions import FreeMotions
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import BoxObstacle, CylinderObstacle, Placement
from cellapp.ground.progress import Cancelled, CancelToken
from tests.cell.planning.hand_made import same_stops, some_stops
from tests.cell.planning.planned_cells import one_arm, planned_twin, refusals, seven_joints, three_arms
from tests.twin import with_arms

SPARE = 1.2
"""Drawn stops for each that is planned: some lie nearer to the floor than motions may come."""


def planned(profile: Profile, seed: int = 1, **rest) -> Sequenced:
    cell = cell_bodies(profile)
    count = math.ceil(SPARE * (profile.plan.stops + profile.plan.reserve))
    chosen = draw_stops(cell, profile, count, np.random.default_rng(seed))
    return sequenced(profile, cell, chosen, np.random.default_rng(seed), **rest)


@cache
def large() -> tuple[Profile, PlannedStops]:
    """A plan of 100 stops of the twin."""
    profile = planned_twin(100, repeats=6, dwell=(0.0, 2.0))
    return profile, planned(profile).stops


def test_the_gate_accepts_every_motion_of_a_plan() -> None:
    profile, stops = large()
    cell, homes = cell_bodies(profile), home_positions(profile)
    assert len(stops) == 100
    assert refusals(cell, stops, homes, homes) == []
    assert all(
        visible_stops(cell, {name: q[None] for name, q in stops.targets(stop).items()})[0] for stop in range(100)
    )


@pytest.mark.parametrize(
    ("make", "stops"),
    [
        (one_arm, 1),
        (one_arm, 12),
        (three_arms, 12),
        (seven_joints, 12),
        (planned_twin, 1),
        (planned_twin, 2),
        (planned_twin, 5),
    ],
)
def test_plans_of_other_cells_and_sizes(make: Callable[[int], Profile], stops: int) -> None:
    profile = make(stops)
    cell, homes = cell_bodies(profile), home_positions(profile)
    plan = planned(profile).stops
    assert len(plan) == stops
    assert list(plan.q) == list(profile.arms)
    assert refusals(cell, plan, homes, homes) == []
    assert all(abs(one.correlation) <= 1.0 + 1e-9 for one in correlations(profile, cell, plan))


@pytest.mark.parametrize("plane", [{"floor": -0.08}, {"ceiling": 1.75}])
def test_tight_cells_are_planned_with_detours_or_sentences(plane: dict[str, float]) -> None:
    """The arms stand close to a plane, so that many straight ways are blocked."""
    profile = planned_twin(25, **plane)
    cell, homes = cell_bodies(profile), home_positions(profile)
    found = planned(profile)
    assert len(found.stops) >= 20
    assert refusals(cell, found.stops, homes, homes) == []
    assert all("cannot be reached" in one or "no way" in one for one in found.given_up)


def test_the_seed_makes_the_plan() -> None:
    profile = planned_twin(8)
    same_stops(planned(profile).stops, planned(profile).stops)
    assert not np.array_equal(planned(profile, 2).stops.q["left"], planned(profile).stops.q["left"])


def test_factors_of_a_hundred_stops_correlate_little() -> None:
    profile, stops = large()
    found = correlations(profile, cell_bodies(profile), stops)
    worst = max(found, key=lambda one: abs(one.correlation))
    assert abs(worst.correlation) <= 0.2, worst  # of random signs it would be some 0.3
    assert {one.arm for one in found} == {"all", "left", "right"}
    assert {"time", "dwell"} <= {one.factor for one in found}


def test_the_order_saves_travel() -> None:
    profile, stops = large()
    rng = np.random.default_rng(0)
    travel = travel_time(profile, stops, TransitPlanner(profile, cell_bodies(profile), rng), rng)
    assert travel.saved > 0.2  # blocks of 25 stops; with 400 stops more than a third


def test_blocks_are_equal_fair_samples_one_after_the_other() -> None:
    _, stops = large()
    assert np.all(np.diff(stops.block) >= 0)
    sizes = np.bincount(stops.block)
    assert len(sizes) == 4
    assert np.ptp(sizes) <= 4  # one more or less, and the repeats that were inserted
    for q in stops.q.values():
        for function in (np.sin(q), np.cos(q)):
            means = np.array([function[stops.block == block].mean(axis=0) for block in range(4)])
            chance = function.std(axis=0) / math.sqrt(sizes.min())
            assert np.sqrt(np.mean(((means - function.mean(axis=0)) / chance) ** 2)) < 0.8


def test_repeats_come_from_the_other_side_much_later() -> None:
    _, stops = large()
    copies = np.flatnonzero(stops.repeat_of >= 0)
    assert len(copies) == 6
    first = stops.repeat_of[copies]
    assert np.all(copies - first >= 25)
    assert len(set(first.tolist())) == 6
    for name, q in stops.q.items():
        np.testing.assert_array_equal(q[copies], q[first])
        step = q - stops.approach_from[name]
        np.testing.assert_allclose(step[copies], -step[first], atol=1e-12)


def test_last_motions_are_steps_of_the_profile_inside_the_limits() -> None:
    profile, stops = large()
    cell = cell_bodies(profile)
    for name, q in stops.q.items():
        start = stops.approach_from[name]
        low, high = cell.arms[name].limits.T
        rows = np.isfinite(start).all(axis=1)
        assert rows.mean() > 0.95
        assert np.all((start[rows] >= low) & (start[rows] <= high))
        sizes = np.abs(q - start)[rows]
        assert np.all(np.isclose(sizes[..., None], profile.plan.steps).any(axis=-1) | np.isclose(sizes, 0.0))
        assert np.all(np.isin(stops.dwell_s[name], profile.plan.dwell))
        assert abs(np.mean(np.sign(q - start)[rows])) < 0.15
    np.testing.assert_array_equal(stops.dwell_s["left"], stops.dwell_s["right"])
    assert 0.4 < np.mean(stops.dwell_s["left"] == 2.0) < 0.6


def test_joints_near_a_limit_come_from_inside() -> None:
    limits = tuple((-2.6, -0.5) if joint == 1 else (-3.1, 3.1) for joint in range(6))
    profile = with_arms(planned_twin(15), limits=limits)
    stops = planned(profile).stops
    for name in stops.q:
        start = stops.approach_from[name]
        assert np.nanmin(start[:, 1]) >= -2.6
        assert np.nanmax(start[:, 1]) <= -0.5


def test_without_steps_the_ways_are_straight() -> None:
    stops = planned(planned_twin(8, steps=(), repeats=0)).stops
    assert all(np.isnan(start).all() for start in stops.approach_from.values())


def test_reserves_follow_and_are_reached_from_the_asked_stops() -> None:
    profile = planned_twin(12, reserve=4, repeats=2)
    cell, homes = cell_bodies(profile), home_positions(profile)
    stops = planned(profile).stops
    assert len(stops) == 16
    assert np.all(stops.repeat_of[12:] < 0)
    assert stops.block[12] > stops.block[11]
    assert refusals(cell, stops, homes, homes) == []


def test_an_extension_begins_at_the_last_stop_that_exists() -> None:
    profile, before = large()
    cell, homes = cell_bodies(profile), home_positions(profile)
    kept = {name: q.copy() for name, q in before.q.items()}
    chosen = draw_stops(cell, profile, 12, np.random.default_rng(9))
    stops = sequenced(profile, cell, chosen, np.random.default_rng(9), after=kept).stops
    assert refusals(cell, stops, before.targets(99), homes) == []
    for name, q in kept.items():
        np.testing.assert_array_equal(q, before.q[name])
        assert len(stops.q[name]) <= 12


def test_joints_are_planned_in_the_turn_nearest_to_home() -> None:
    profile = planned_twin(30)
    cell, homes = cell_bodies(profile), home_positions(profile)
    for name, q in draw_stops(cell, profile, 30, np.random.default_rng(3)).items():
        turned = nearest_turns(profile, cell, name, q)
        np.testing.assert_allclose(np.sin(turned), np.sin(q), atol=1e-9)
        np.testing.assert_allclose(np.cos(turned), np.cos(q), atol=1e-9)
        assert np.all(np.abs(turned - homes[name]) <= math.pi + 1e-9)
        ranged = planned_twin(30, ranges=((-math.pi, math.pi),) * 6)
        np.testing.assert_allclose(nearest_turns(ranged, cell, name, q), q)


def test_stops_that_no_motion_reaches_are_given_up_with_the_reason() -> None:
    """An arm below the floor is reached by nothing."""
    profile = planned_twin(6, repeats=0)
    cell = cell_bodies(profile)
    chosen = draw_stops(cell, profile, 6, np.random.default_rng(1))
    chosen["left"][:2, 1] = 1.2
    found = sequenced(profile, cell, chosen, np.random.default_rng(1))
    assert len(found.stops) <= 4
    assert any(one.startswith("arm left: 2 of 6 chosen") and "floor" in one for one in found.given_up)
    chosen["left"][:, 1] = 1.2
    with pytest.raises(InputError, match=r"none of the chosen stops can be reached.*floor"):
        sequenced(profile, cell, chosen, np.random.default_rng(1))


def test_repeats_are_at_most_a_quarter() -> None:
    assert [distinct_stops(planned_twin(repeats=10), n) for n in (400, 40, 39, 8, 3, 1)] == [390, 30, 30, 6, 3, 1]


def test_planning_can_be_cancelled() -> None:
    token = CancelToken()
    token.cancel()
    with pytest.raises(Cancelled):
        planned(planned_twin(8), cancel=token)


# -- Orders of stops: exact bookkeeping of moves, short tours, fair blocks, balanced levels ----------------------------


def task_of(time_s: np.ndarray, sizes: list[int], pair_cost: np.ndarray | None = None, **rest) -> TourTask:
    arms, blocks, m, _ = time_s.shape
    pairs = arms * (arms - 1) // 2
    cost = np.zeros((pairs, blocks, m, m)) if pair_cost is None else pair_cost
    rest = {"postures": [np.zeros((blocks, m, 1))] * arms, "correlation_cost": 0.0, **rest}
    return TourTask(sizes=np.array(sizes), time_s=time_s, pair_cost=cost, correlation_goal=0.1, **rest)


def distances(rng: np.random.Generator, arms: int, blocks: int, m: int) -> np.ndarray:
    points = rng.uniform(size=(arms, blocks, m, 3))
    return np.linalg.norm(points[:, :, :, None] - points[:, :, None], axis=-1)


def length(time_s: np.ndarray, order: np.ndarray) -> float:
    return float(np.max([one[way[:-1], way[1:]] for one, way in zip(time_s, order, strict=True)], axis=0).sum())


@settings(max_examples=60)
@given(st.integers(0, 10_000))
def test_the_steps_of_a_move_are_those_that_its_order_changes(seed: int) -> None:
    """For every kind: what is given up and what is taken up makes the difference of both orders."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 9))
    low, high = (np.array([one]) for one in sorted(rng.choice(np.arange(1, n + 1), 2, replace=False).tolist()))
    shift = np.array([rng.integers(1, high[0] - low[0] + 1)])
    time_s = rng.uniform(size=(n + 2, n + 2))
    time_s += time_s.T  # a part that is reversed takes as long as before
    np.fill_diagonal(time_s, 0.0)
    for move in (Move("reverse", low, high), Move("shift", low, high, shift), Move("exchange", low, high)):
        before = np.arange(n + 2)
        after = before.copy()
        after[1:-1] = move.source(np.arange(1, n + 1))
        assert sorted(after.tolist()) == before.tolist()
        steps = [(int(at[0]), int(start[0]), int(end[0])) for at, start, end in move.steps()]
        added = sum(time_s[start, end] - time_s[at - 1, at] for at, start, end in steps if at > 0)
        assert added == pytest.approx(time_s[after[:-1], after[1:]].sum() - time_s[before[:-1], before[1:]].sum())


@pytest.mark.parametrize("seed", range(4))
def test_small_tours_are_hardly_longer_than_the_best(seed: int) -> None:
    """One arm with six stops, and two arms with four, against all orders and pairs."""
    rng = np.random.default_rng(seed)
    for arms, m in ((1, 6), (2, 4)):
        time_s = distances(rng, arms, 1, m)
        order = best_order(task_of(time_s, [m]), 400, rng, CancelToken())[:, 0]
        every = (length(time_s[:, 0], np.array(ways)) for ways in product(permutations(range(m)), repeat=arms))
        assert length(time_s[:, 0], order) <= 1.05 * min(every)


@pytest.mark.parametrize("seed", range(3))
def test_forbidden_pairs_and_correlations_are_avoided(seed: int) -> None:
    """The stops of both arms are in two places, and it costs a little where the arms are not in the same one."""
    rng = np.random.default_rng(seed)
    there = np.repeat([0.0, 1.0], 15)
    time_s = np.tile(np.abs(there[:, None] - there) + 0.01, (2, 1, 1, 1))
    forbidden = np.where(np.abs(np.arange(30)[:, None] - np.arange(30)) % 7 == 3, 100.0, 0.0)[None, None]
    cost_s = np.maximum(forbidden, 0.05 * np.abs(there[:, None] - there))
    posture = standardised(("q",), there[:, None]).values[None]
    free, charged = (
        best_order(
            task_of(time_s, [30], cost_s, postures=[posture] * 2, correlation_cost=cost), 600, rng, CancelToken()
        )[:, 0]
        for cost in (0.0, 10.0)
    )
    for order in (free, charged):
        assert np.all(forbidden[0, 0][order[0], order[1]] == 0.0)
    correlation = [abs(float(np.mean(posture[0, one[0], 0] * posture[0, one[1], 0]))) for one in (free, charged)]
    assert correlation[0] > 0.5
    assert correlation[1] < 0.25


def test_pairs_stand_together_and_an_order_is_mended() -> None:
    """Three arms; a mended order has the same pairs, in the same blocks, with no more refused ways."""
    profile = three_arms(18)
    cell, homes = cell_bodies(profile), home_positions(profile)
    stops = StopSet(profile, cell, draw_stops(cell, profile, 18, np.random.default_rng(2)))
    arrangement = arrange(stops, 3, 2, np.random.default_rng(0), CancelToken())
    assert arrangement.rows.shape == (3, 20)
    assert stops.together(arrangement.rows).all()
    mended = repair_order(stops, arrangement, homes, homes, FreeMotions(cell), CancelToken())
    assert sorted(map(tuple, mended.rows.T.tolist())) == sorted(map(tuple, arrangement.rows.T.tolist()))
    np.testing.assert_array_equal(mended.block, arrangement.block)
    copies = np.flatnonzero(mended.repeat_of >= 0)
    np.testing.assert_array_equal(mended.rows[:, copies], mended.rows[:, mended.repeat_of[copies]])
    assert np.all(mended.repeat_of[copies] < copies)


# -- Distances between segments: known cases, and every case against a search over both segments -----------------------

KNOWN = [
    # a0, a1, b0, b1, distance
    ((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), 1.0),  # parallel, side by side
    ((0, 0, 0), (1, 0, 0), (3, 0, 0), (2, 0, 0), 1.0),  # on one line
    ((0, 0, 0), (2, 0, 0), (1, 0, 0), (3, 0, 0), 0.0),  # on one line, overlapping
    ((0, 0, 0), (1, 0, 0), (2, 1, 0), (4, 1, 0), np.sqrt(2.0)),  # parallel, past each other
    ((-1, 0, 0), (1, 0, 0), (0, -1, 0.3), (0, 1, 0.3), 0.3),  # crossing inside both
    ((-1, 0, 0), (1, 0, 0), (0, 2, 0), (0, 1, 0), 1.0),  # an end against an inside
    ((0, 0, 0), (0, 0, 0), (0, 3, 4), (0, 3, 4), 5.0),  # two points
    ((0, 0, 0), (0, 0, 0), (-1, 2, 0), (1, 2, 0), 2.0),  # a point and a segment
    ((-1, 2, 0), (1, 2, 0), (0, 0, 0), (0, 0, 0), 2.0),
    ((0, 0, 0), (1, 0, 0), (2, 2, 0), (3, 4, 0), np.sqrt(5.0)),  # both at an end
]


@pytest.mark.parametrize(("a0", "a1", "b0", "b1", "distance"), KNOWN)
def test_known_distances(a0: tuple, a1: tuple, b0: tuple, b1: tuple, distance: float) -> None:
    ends = [np.array(end, dtype=np.float64) for end in (a0, a1, b0, b1)]
    assert segment_distance(*ends) == pytest.approx(distance, abs=1e-12)
    assert segment_distance(ends[2], ends[3], ends[0], ends[1]) == pytest.approx(distance, abs=1e-12)
    assert segment_distance(ends[1], ends[0], ends[3], ends[2]) == pytest.approx(distance, abs=1e-12)


def searched(a0: np.ndarray, a1: np.ndarray, b0: np.ndarray, b1: np.ndarray) -> float:
    """The distance as a bounded least-squares problem over both shares."""
    A = np.column_stack([a1 - a0, b0 - b1])
    found = lsq_linear(A, b0 - a0, bounds=(0.0, 1.0), method="bvls", tol=1e-14)
    return float(np.sqrt(2.0 * found.cost))


POINTS = hnp.arrays(np.float64, (4, 3), elements=st.integers(-4, 4).map(lambda k: 0.25 * k))


@settings(max_examples=300, deadline=None)
@given(points=POINTS, turned=st.floats(-1e-6, 1e-6))
@example(points=np.zeros((4, 3)), turned=0.0)
@example(points=np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 0], [1.5, 0, 0]]), turned=1e-7)
def test_against_a_search(points: np.ndarray, turned: float) -> None:
    # a coarse lattice gives points, parallel and touching segments; the turn makes them nearly so
    a0, a1, b0, b1 = points
    b1 = b1 + turned * np.array([0.3, -0.7, 0.2])
    assert float(segment_distance(a0, a1, b0, b1)) == pytest.approx(searched(a0, a1, b0, b1), abs=2e-6)


def test_many_at_once_are_each_alone() -> None:
    rng = np.random.default_rng(5)
    a0, a1 = rng.normal(size=(2, 7, 1, 3))
    b0, b1 = rng.normal(size=(2, 1, 5, 3))
    all_of_them = segment_distance(a0, a1, b0, b1)
    assert all_of_them.shape == (7, 5)
    for i in range(7):
        for k in range(5):
            assert all_of_them[i, k] == pytest.approx(searched(a0[i, 0], a1[i, 0], b0[0, k], b1[0, k]), abs=1e-9)


# -- Ways round what blocks the straight one: the gate accepts every leg; what cannot be reached has a reason ----------

OUT = np.array([0.0, -0.6, 0.3, -1.0, 0.3, 0.2])
"""Joint positions with which the left arm is stretched out."""


def with_pillar(profile: Profile) -> Profile:
    """A pillar where the left arm stretches out to, and a table between the arms."""
    x, y, _ = place(cell_bodies(profile).arms["left"], OUT[None]).smr[0]
    pillar = CylinderObstacle(shape="cylinder", radius=0.05, length=1.4, pose=Placement(position=(x, y, 0.5)))
    table = BoxObstacle(shape="box", size=(0.5, 0.4, 0.3), pose=Placement(position=(-0.5, 0.0, -0.05)))
    return profile.model_copy(update={"obstacles": {"pillar": pillar, "table": table}})


def both_sides(cell: CellBodies) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The left arm stretched out on either side of the pillar; the straight way leads through it."""
    here, there = ({"left": OUT + np.array([turn, 0.0, 0.0, 0.0, 0.0, 0.0])} for turn in (-0.5, 0.5))
    assert not refuse_motion(cell, here, here)
    assert not refuse_motion(cell, there, there)
    assert "pillar" in refuse_motion(cell, here, there)
    return here, there


def replay(cell: CellBodies, here: dict[str, np.ndarray], way: TransitPath, there: dict[str, np.ndarray]) -> list[str]:
    found = []
    for leg in (*way.legs, there):
        after = {**here, **leg}
        found.append(refuse_motion(cell, here, after))
        here = after
    return [one for one in found if one]


def test_a_way_leads_round_a_pillar() -> None:
    profile = with_pillar(one_arm())
    cell = cell_bodies(profile)
    here, there = both_sides(cell)
    way = TransitPlanner(profile, cell, np.random.default_rng(0)).find(here, there)
    assert isinstance(way, TransitPath)
    assert way.legs
    assert replay(cell, here, way, there) == []
    assert way.seconds == pytest.approx(route_s(profile, here, (*way.legs, there)))
    home = home_positions(profile)
    assert way.seconds <= route_s(profile, here, (home, there)) + 1e-9


def test_arms_that_would_meet_go_another_way() -> None:
    profile = planned_twin(200)
    cell = cell_bodies(profile)
    drawn = draw_stops(cell, profile, 200, np.random.default_rng(4))
    q = {name: nearest_turns(profile, cell, name, rows) for name, rows in drawn.items()}
    stops = [{name: rows[k] for name, rows in q.items()} for k in range(200)]
    meeting = [one for one in pairwise(stops) if refuse_motion(cell, *one).startswith("arms ")][:3]
    finder = TransitPlanner(profile, cell, np.random.default_rng(0))
    found = [finder.find(*one) for one in meeting]
    assert any(isinstance(way, TransitPath) for way in found)
    for (here, there), way in zip(meeting, found, strict=True):
        assert not isinstance(way, TransitPath) or replay(cell, here, way, there) == []


def test_roadmaps_know_what_the_limits_shut_off() -> None:
    """With limits of half a turn, wrist 1 beyond a quarter turn is on the other side of the forearm."""
    profile = one_arm()
    left = profile.arms["left"].model_copy(update={"limits": ((-math.pi, math.pi),) * 6})
    profile = profile.model_copy(update={"arms": {"left": left}})
    roadmap = ArmRoadmap(profile, cell_bodies(profile), "left", np.random.default_rng(0))
    home = roadmap.rest
    beyond = home + np.array([0.0, 0.0, 0.0, math.radians(240.0), 0.0, 0.0])
    near = home + np.array([0.5, 0.2, 0.1, 0.3, 0.0, 0.0])
    below = home + np.array([0.0, 2.4, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(roadmap.reaches(np.array([near, beyond, below, home])), [True, False, False, True])
    path = roadmap.path(near, home)
    assert path is not None
    assert len(path) == 0


def test_an_arm_without_home_has_a_roadmap() -> None:
    profile = one_arm()
    arm = profile.arms["left"].model_copy(update={"home": None})
    profile = profile.model_copy(update={"arms": {"left": arm}})
    cell = cell_bodies(profile)
    roadmap = ArmRoadmap(profile, cell, "left", np.random.default_rng(0))
    q = draw_stops(cell, profile, 12, np.random.default_rng(0))
    assert roadmap.reaches(q["left"]).mean() > 0.5
    found = sequenced(profile, cell, q, np.random.default_rng(0))
    first = {name: rows[0] for name, rows in found.stops.approach_from.items()}
    assert refusals(cell, found.stops, first) == []


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_plans_among_obstacles_pass_the_gate(seed: int) -> None:
    profile = with_pillar(planned_twin(16))
    cell, homes = cell_bodies(profile), home_positions(profile)
    chosen = draw_stops(cell, profile, 20, np.random.default_rng(seed))
    found = sequenced(profile, cell, chosen, np.random.default_rng(seed))
    assert len(found.stops) >= 14
    assert refusals(cell, found.stops, homes, homes) == []


def test_times_of_stops_are_those_of_their_motions() -> None:
    profile = planned_twin(6)
    stops = some_stops(6)
    times = stop_times_of(profile, stops)
    here = home_positions(profile)
    for stop in range(6):
        begin = {**stops.targets(stop), **stops.approach_starts(stop)}
        route = (*stops.legs[stop], begin, stops.targets(stop))
        assert times.moving_s[stop] == pytest.approx(route_s(profile, here, route))
        here = stops.targets(stop)
    straight = straight_stops(stops.q)
    ways = {name: np.diff(q, axis=0) for name, q in stops.q.items()}
    expected = np.max([motion_s(profile.arms[name], way) for name, way in ways.items()], axis=0)
    np.testing.assert_allclose(stop_times_of(profile, straight).moving_s[1:], expected)


def test_a_confounded_factor_is_found() -> None:
    """All last motions of joint 2 come from above where its sine is positive."""
    profile = planned_twin(40)
    rng = np.random.default_rng(0)
    stops = straight_stops({name: rng.uniform(-2.0, 2.0, (40, 6)) for name in profile.arms})
    for name, q in stops.q.items():
        step = rng.choice([-0.1, 0.1], q.shape)
        step[:, 1] = np.where(np.sin(q[:, 1]) > 0.0, 0.1, -0.1) if name == "left" else step[:, 1]
        stops.approach_from[name][:] = q - step
    found = correlations(profile, cell_bodies(profile), stops)
    worst = max(found, key=lambda one: abs(one.correlation) * one.factor.startswith("approach"))
    assert worst.factor == "approach side of joint 2 of left"
    assert worst.other == "sin q2 of left"
    assert worst.correlation > 0.8
