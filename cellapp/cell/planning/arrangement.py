"""Pairing and order of the stops of all arms in random blocks: little travel, posture not confounded with time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.balance import Columns, fair_blocks, posture_functions
from cellapp.cell.planning.planned_stops import motion_s
from cellapp.cell.planning.transit_paths import Order, TourTask, best_order
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.gate import CellBodies, clear_alone, clear_pairs, with_margin_for_ways
from cellapp.ground.profile import Profile
from cellapp.ground.progress import JobToken
from cellapp.robot.kinematics.transforms import Array

# -- The chosen stops of each arm before they are paired: postures, times between stops, pairs that are compatible ----


Rows = NDArray[np.intp]
"""Indices of stops; with a first axis of length K, one index for each arm."""

_PARTS_OF_WAY = (0.5, 0.25, 0.75, 0.125, 0.875, 0.375, 0.625)
"""Fractions of the motion between two stops at which an arm is checked alone: they find most collisions."""


@dataclass(frozen=True, eq=False)
class StopSet:
    """n stops of each of K arms.

    Attributes
    ----------
    profile : Profile
    cell : CellBodies
    q : mapping
        Arm -> joint positions (n, N) [rad], in the order of the arms' numbers 0 to K - 1.
    """

    profile: Profile
    cell: CellBodies
    q: Mapping[str, Array]

    @property
    def size(self) -> int:
        """Number of stops of each arm."""
        return len(next(iter(self.q.values())))

    @cached_property
    def postures(self) -> tuple[Columns, ...]:
        """Posture functions of the stops of each arm."""
        return tuple(posture_functions(self.profile, self.cell, name, q) for name, q in self.q.items())

    @cached_property
    def cell_of_ways(self) -> CellBodies:
        """The cell with a larger clearance: the gate accepts the motions of an arm that keeps it."""
        return with_margin_for_ways(self.cell)

    @cached_property
    def usual_step_s(self) -> float:
        """Mean time of a motion between two stops in random order [s]."""
        rows = np.arange(self.size)
        return float(np.mean(self.step_s(np.stack([rows] * len(self.q)), np.stack([np.roll(rows, 1)] * len(self.q)))))

    def at(self, rows: Sequence[int] | Rows) -> dict[str, Array]:
        """Return the joint positions of all arms: of arm k at its stop(s) ``rows[k]``."""
        return {name: q[row] for (name, q), row in zip(self.q.items(), rows, strict=True)}

    def step_s(self, start: Rows, end: Rows) -> Array:
        """Compute the time of the slowest arm from stops ``start`` (K, n) to ``end`` (K, n), shape (n,) [s]."""
        here, there = self.at(start), self.at(end)
        return np.asarray(np.max([motion_s(self.profile.arms[one], there[one] - here[one]) for one in here], axis=0))

    def arm_times_s(self, name: str, rows: Rows) -> Array:
        """Compute the time of an arm alone between all pairs of the stops ``rows`` (m,), shape (m, m) [s].

        Motions on which the arm alone is not clear get the time of a mean step more: a detour costs about that. Motions
        that take longer than a mean step are not checked.
        """
        cell = self.cell_of_ways
        q, m = self.q[name][rows], len(rows)
        i, k = np.triu_indices(m, 1)
        way = q[k] - q[i]
        seconds = motion_s(self.profile.arms[name], way)
        looked_at = seconds < self.usual_step_s  # an order hardly has longer ones
        free = np.ones(len(way), dtype=bool)
        for part in _PARTS_OF_WAY:
            remaining = np.flatnonzero(free & looked_at)
            free[remaining] = clear_alone(cell, place(cell.arms[name], q[i[remaining]] + part * way[remaining]))
        times: Array = np.zeros((m, m))
        times[i, k] = times[k, i] = seconds + np.where(free, 0.0, self.usual_step_s)
        return times

    def compatible_stops(self, first: str, second: str, rows: Rows, partners: Rows) -> NDArray[np.bool_]:
        """Return whether arm ``first`` is clear and visible at ``rows`` (m,) while ``second`` is at ``partners`` (p,).

        Returns
        -------
        array, shape (m, p), bool
        """
        two = replace(self.cell, arms={name: self.cell.arms[name] for name in (first, second)})
        pair = with_margin_for_ways(two, between_arms=True)
        return clear_pairs(pair, (first, self.q[first][rows]), (second, self.q[second][partners]))


_STOPS_PER_BLOCK = 100
"""Stops of a block. Fewer make travel longer, as each block covers the whole workspace; more leave too few blocks."""
_LEAST_BLOCKS, _LEAST_STOPS = 4, 6
"""Blocks of smaller plans, and stops in them: with fewer than four blocks, time and posture correlate; fewer than six
stops are hardly a sample of the workspace."""
_STEPS_PER_STOP = 3
"""Steps of the search for each stop; twice as many save only one percent more travel."""
_LEAST_STEPS = 500
_FORBIDDEN_STEPS = 20.0
"""Cost of a pair that is not compatible, in mean steps: never worth it."""
_PAIR_GOAL = 0.1
"""Correlation of two arms' postures that costs ``_PAIR_WEIGHT``: below the largest accepted one."""
_PAIR_WEIGHT = 7.5e-4
"""Cost of such a correlation for each stop, in mean steps."""
_DRIFT_GOALS = (0.06, 0.1, 0.1, 0.1)
"""Acceptable correlations of time, and of the other drift courses, with posture."""
_DECAY = 2.0
"""Half the duration of a plan over the time constant of an exponential drift: an arm is warm after a quarter of it."""
_ORDERS = 2000
"""Number of random orders and directions of the blocks that are compared."""
_REPEAT_CANDIDATES = 4
"""Number of stops considered for each repeat."""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """n stops of all arms in their order.

    Attributes
    ----------
    rows : array, shape (K, n), int
        Index of the stop of each arm in the set.
    block : array, shape (n,), int
    repeat_of : array, shape (n,), int
        Place of the stop that is visited again; -1 for none.
    """

    rows: Rows
    block: NDArray[np.intp]
    repeat_of: NDArray[np.intp]

    def taken(self, source: NDArray[np.intp]) -> Arrangement:
        """Reorder the stops; ``source`` holds their current places. Of two visits the later one becomes the repeat."""
        place = np.argsort(source)
        repeat_of = np.full(len(source), -1, dtype=np.intp)
        copies = np.flatnonzero(self.repeat_of >= 0)
        visits = np.sort(place[[copies, self.repeat_of[copies]]], axis=0)
        repeat_of[visits[1]] = visits[0]
        return Arrangement(self.rows[:, source], self.block[source], repeat_of)


def block_count(asked: int | None, stops: int) -> int:
    """Return the number of blocks of a plan of ``stops`` stops; ``asked`` is the number in the profile, if any."""
    if asked is not None:
        return max(1, min(asked, stops))
    return max(1, min(max(_LEAST_BLOCKS, round(stops / _STOPS_PER_BLOCK)), stops // _LEAST_STOPS))


def arrange(stops: StopSet, blocks: int, repeats: int, rng: np.random.Generator, job: JobToken) -> Arrangement:
    """Pair and order the stops; ``repeats`` of them are visited twice."""
    n = stops.size
    sizes = np.full(blocks, n // blocks)
    sizes[rng.permutation(blocks)[: n % blocks]] += 1
    members = np.stack([_members(fair_blocks(one.values, sizes, rng), sizes) for one in stops.postures])
    time_s = np.zeros((*members.shape, members.shape[2]))
    for block, size in enumerate(sizes.tolist()):
        job.check()
        for arm, name in enumerate(stops.q):
            time_s[arm, block, :size, :size] = stops.arm_times_s(name, members[arm, block, :size])
    task = TourTask(
        sizes,
        time_s,
        _pair_cost(stops, members, sizes),
        [np.where(of_arm[..., None] >= 0, one.values[of_arm], 0.0) for one, of_arm in zip(stops.postures, members)],
        _PAIR_GOAL,
        _PAIR_WEIGHT * n * stops.usual_step_s,
    )
    order = best_order(task, max(_LEAST_STEPS, _STEPS_PER_STOP * n), rng, job)
    ways = [
        np.stack([members[arm, block, order[arm, block, :size]] for arm in range(len(members))])
        for block, size in enumerate(sizes.tolist())
    ]
    return _with_repeats(stops, _best_blocks(stops, ways, rng), repeats, rng)


def _members(block: NDArray[np.intp], sizes: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the indices of the stops of each block (B, m), -1 beyond its size."""
    members = np.full((len(sizes), int(sizes.max())), -1, dtype=np.intp)
    for number, size in enumerate(sizes.tolist()):
        members[number, :size] = np.flatnonzero(block == number)
    return members


def _pair_cost(stops: StopSet, members: Order, sizes: NDArray[np.intp]) -> Array:
    """Compute the cost of incompatible pairs of two arms' stops (pairs of arms, B, m, m) [s]; 0 for others."""
    pairs, m = list(combinations(zip(stops.q, members, strict=True), 2)), members.shape[2]
    cost = np.zeros((len(pairs), len(sizes), m, m))
    for number, ((first, of_first), (second, of_second)) in enumerate(pairs):
        for block, size in enumerate(sizes.tolist()):
            allowed = stops.compatible_stops(first, second, of_first[block, :size], of_second[block, :size])
            cost[number, block, :size, :size] = np.where(allowed, 0.0, _FORBIDDEN_STEPS * stops.usual_step_s)
    return cost


def _best_blocks(stops: StopSet, ways: list[Rows], rng: np.random.Generator) -> Arrangement:
    """Concatenate the blocks in the best of many random orders and directions.

    Neither time nor other drift courses should correlate with posture, and motions between blocks should be short.
    """
    blocks, n = len(ways), sum(way.shape[1] for way in ways)
    both_ways = [*ways, *(way[:, ::-1] for way in ways)]  # block k, and reversed as block k + B
    order = np.argsort(rng.random((_ORDERS, blocks)), axis=1)
    order += blocks * (rng.random(order.shape) < 0.5)
    first = np.stack([way[:, 0] for way in both_ways], axis=1)
    last = np.stack([way[:, -1] for way in both_ways], axis=1)
    i, k = np.indices((2 * blocks, 2 * blocks)).reshape(2, -1)
    between_s = stops.step_s(last[:, i], first[:, k]).reshape(2 * blocks, 2 * blocks)
    cost = between_s[order[:, :-1], order[:, 1:]].sum(axis=1)
    for goal, largest in zip(_DRIFT_GOALS, _drift_correlations(stops, both_ways, order), strict=True):
        cost += n * stops.usual_step_s * np.maximum(largest - goal, 0.0)
    parts = [both_ways[k] for k in order[np.argmin(cost)].tolist()]
    block = np.repeat(np.arange(blocks), [part.shape[1] for part in parts])
    return Arrangement(np.concatenate(parts, axis=1), block, np.full(n, -1, dtype=np.intp))


def _drift_correlations(stops: StopSet, ways: list[Rows], order: NDArray[np.intp]) -> Array:
    """Compute the largest correlation of each drift course with posture, for orders (r, B) of blocks: (courses, r).

    Blocks are taken as equally long; they differ by one stop at most.
    """
    blocks, size = order.shape[1], max(way.shape[1] for way in ways)
    drift = _drift_courses(blocks * size).reshape(-1, blocks, size)
    largest = np.zeros((len(drift), len(order)))
    for arm, posture in enumerate(stops.postures):
        sums = np.stack([drift[:, :, : way.shape[1]] @ posture.values[way[arm]] for way in ways])
        correlation = sums.transpose(0, 2, 1, 3)[order, np.arange(blocks)].sum(axis=1) / stops.size
        largest = np.maximum(largest, np.abs(correlation).max(axis=2, initial=0.0).T)
    return largest


def _drift_courses(n: int) -> Array:
    """Return drift courses over n stops with mean 0 and deviation 1: linear, quadratic, cubic, exponential."""
    time = np.linspace(-1.0, 1.0, n)
    courses = np.stack([time, time**2, time**3 - 0.6 * time, np.exp(-_DECAY * (time + 1.0))])
    centred = courses - courses.mean(axis=1, keepdims=True)
    return np.asarray(centred / np.maximum(centred.std(axis=1, keepdims=True), 1e-12))


def _with_repeats(stops: StopSet, once: Arrangement, repeats: int, rng: np.random.Generator) -> Arrangement:
    """Visit some stops of the first half again, at least a third of the plan later, where it costs least time."""
    n = once.rows.shape[1]
    early = rng.permutation(max(1, n // 2))
    behind: dict[int, list[int]] = {}
    for group in np.array_split(early[: repeats * _REPEAT_CANDIDATES], repeats) if repeats else ():
        best = (np.inf, 0, 0)
        for first in group.tolist():
            slots = np.arange(min(first + n // 3, n - 1), n)
            row = np.repeat(once.rows[:, first : first + 1], len(slots), axis=1)
            here, there = once.rows[:, slots], once.rows[:, np.minimum(slots + 1, n - 1)]
            added = stops.step_s(here, row) + np.where(
                slots + 1 < n, stops.step_s(row, there) - stops.step_s(here, there), 0.0
            )
            added += np.array([1e3 * (slot in behind) for slot in slots.tolist()])
            least = int(np.argmin(added))
            best = min(best, (float(added[least]), first, int(slots[least])))
        behind.setdefault(best[2], []).append(best[1])
    source = [(place, copy) for place in range(n) for copy in (-1, *behind.get(place, ()))]
    rows = np.array([place if copy < 0 else copy for place, copy in source], dtype=np.intp)
    new_place = {place: k for k, (place, copy) in enumerate(source) if copy < 0}
    return Arrangement(
        once.rows[:, rows],
        once.block[[place for place, _ in source]],
        np.array([-1 if copy < 0 else new_place[copy] for _, copy in source], dtype=np.intp),
    )
