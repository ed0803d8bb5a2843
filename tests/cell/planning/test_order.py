"""Orders of stops: exact bookkeeping of moves, short tours, fair blocks, balanced levels."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.cell.planning.arrangement import Arrangement, StopSet, arrange, block_count
from cellapp.cell.planning.balance import balanced_levels, fair_blocks, standardised
from cellapp.cell.planning.plan import draw_stops
from cellapp.cell.planning.sequence import repair_order
from cellapp.cell.planning.transit_paths import Move, TourTask, best_order
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.many_motions import FreeMotions
from cellapp.ground.progress import CancelToken
from tests.cell.planning.planned_cells import planned_twin, three_arms


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


def test_blocks_of_different_sizes_keep_their_stops() -> None:
    rng = np.random.default_rng(0)
    sizes = [5, 4, 1]
    order = best_order(task_of(distances(rng, 3, 3, 5), sizes), 300, rng, CancelToken())
    for arm, (block, size) in product(range(3), enumerate(sizes)):
        assert sorted(order[arm, block, :size].tolist()) == list(range(size))
        assert np.all(order[arm, block, size:] == -1)


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


@given(st.integers(1, 6), st.integers(6, 40), st.integers(0, 1000))
def test_fair_blocks_have_their_sizes(blocks: int, stops: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = np.full(blocks, stops // blocks)
    sizes[rng.permutation(blocks)[: stops % blocks]] += 1
    block = fair_blocks(rng.normal(size=(stops, 4)), sizes, rng)
    np.testing.assert_array_equal(np.bincount(block, minlength=blocks), sizes)


def test_fair_blocks_are_fairer_than_chance() -> None:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(200, 3))

    def spread(block: np.ndarray) -> float:
        return float(np.std([features[block == k].mean(axis=0) for k in range(10)]))

    fair = np.mean([spread(fair_blocks(features, np.full(10, 20), rng)) for _ in range(20)])
    chance = np.mean([spread(rng.permutation(np.repeat(np.arange(10), 20))) for _ in range(20)])
    assert fair < 0.6 * chance


@given(st.integers(0, 1000), st.integers(2, 4))
def test_levels_are_allowed_ones(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    allowed = rng.random((30, count)) < 0.5
    allowed[np.arange(30), rng.integers(count, size=30)] = True
    chosen = balanced_levels(np.arange(count, dtype=float), allowed, rng.normal(size=(30, 5)), rng, 0.0)
    assert np.all(allowed[np.arange(30), chosen])


def test_levels_correlate_less_than_random_ones() -> None:
    """70 variables and 400 stops: random signs give 0.15."""
    rng = np.random.default_rng(0)
    against = np.column_stack([standardised(("",) * 70, rng.normal(size=(400, 70))).values, np.ones(400)])
    for levels in (np.array([-1.0, 1.0]), np.array([1.0, 2.0, 5.0])):
        values = levels[balanced_levels(levels, np.ones((400, len(levels)), dtype=bool), against, rng, 0.03)]
        found = np.abs(np.corrcoef(values, against[:, :-1].T)[0, 1:]).max()
        assert found < 0.05
        counts = np.array([np.sum(values == level) for level in levels])
        assert abs(np.mean(values) - levels.mean()) < 0.05 * levels.std(), counts


@pytest.mark.parametrize(
    ("asked", "stops", "blocks"), [(None, 400, 4), (None, 4000, 40), (None, 5, 1), (9, 5, 5), (3, 50, 3)]
)
def test_number_of_blocks(asked: int | None, stops: int, blocks: int) -> None:
    assert block_count(asked, stops) == blocks


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


def test_of_two_visits_the_later_one_is_the_repeat() -> None:
    before = Arrangement(np.array([[5, 6, 5]]), np.zeros(3, dtype=np.intp), np.array([-1, -1, 0]))
    np.testing.assert_array_equal(before.taken(np.array([2, 1, 0])).repeat_of, [-1, -1, 0])
    np.testing.assert_array_equal(before.taken(np.array([2, 1])).repeat_of, [-1, -1])


def test_one_stop_is_an_order() -> None:
    profile = planned_twin(1)
    cell = cell_bodies(profile)
    stops = StopSet(profile, cell, draw_stops(cell, profile, 1, np.random.default_rng(2)))
    assert arrange(stops, 1, 0, np.random.default_rng(0), CancelToken()).rows.tolist() == [[0], [0]]
