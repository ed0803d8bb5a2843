"""Order and pairing of the stops of several arms that take least time, block by block, by simulated annealing.

Each arm has the same number of stops in a block. A position of a block's order holds one stop of each arm; a step from
one position to the next takes as long as the slowest arm. Which stops share a position costs too (``pair_cost``): so
pairs that are not allowed and correlations between the arms' poses are avoided.

Moves: a part of the order is reversed, or a few positions are shifted to another place, or two positions are exchanged,
for all arms; or two stops of one arm are exchanged, which makes new pairs. Half of the moves bring a stop beside one of
its nearest neighbours. Of each block many moves are tried at once, and the first that is accepted is made: at low
temperature nearly all are refused, so that this is nearly one move after the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from cellapp.kinematics.transforms import Array
from cellapp.progress import CancelToken

_NEIGHBOURS = 10
"""Nearest stops beside which a stop is tried."""
_TRIES_AT_ONCE = 256
"""Moves tried in one step, over all blocks: then numpy's overhead of a call is small against its work."""
_HOT, _COLD = 0.1, 0.01
"""First and last temperature over the mean time between two stops: at first a move that costs half as much as a usual
step is often accepted, at last only gains are."""
_LONGEST_SHIFT = 3
"""Most positions that are shifted together."""
_POWER = 6
_CHECK_EVERY = 50
"""Steps between two looks at the cancel token."""

Order = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class TourTask:
    """Stops of K arms in B blocks of at most m stops.

    Attributes
    ----------
    sizes : array, shape (B,)
        Number of stops of each block, at most m.
    time_s : array, shape (K, B, m, m)
        Time of each arm from one stop of a block to another [s].
    pair_cost : array, shape (pairs of arms, B, m, m)
        Cost of stops of two arms at the same position [s], pairs in the order of ``itertools.combinations``.
    postures : sequence of arrays, shape (B, m, p)
        Variables of each arm with mean 0 and standard deviation 1; 0 beyond the size of a block.
    correlation_goal : float
        Correlations of variables of two arms up to this cost nothing,
    correlation_cost : float
        and beyond it this times the square of the excess [s].
    """

    sizes: NDArray[np.intp]
    time_s: Array
    pair_cost: Array
    postures: Sequence[Array]
    correlation_goal: float
    correlation_cost: float


def best_order(task: TourTask, steps: int, rng: np.random.Generator, cancel: CancelToken) -> Order:
    """Order (K, B, m) of the stops: their numbers within each block; -1 beyond its size.

    Parameters
    ----------
    task : TourTask
    steps : int
        Number of steps; each tries ``_TRIES_AT_ONCE`` moves.
    rng : numpy.random.Generator
    cancel : CancelToken
    """
    tours = _Tours(task, _random_order(task, rng))
    scale = float(np.mean(task.time_s)) or 1.0
    temperatures = np.geomspace(_HOT * scale, _COLD * scale, steps) if task.sizes.max(initial=0) > 1 else ()
    for step, temperature in enumerate(temperatures):
        if step % _CHECK_EVERY == 0:
            cancel.check()
        tours.step(float(temperature), rng)
    return tours.inner


def _random_order(task: TourTask, rng: np.random.Generator) -> Order:
    """An order (K, B, m + 2) with positions of no stop (number m) before the first and after the last stop."""
    arms, blocks, m, _ = task.time_s.shape
    order = np.full((arms, blocks, m + 2), m, dtype=np.intp)
    for block, size in enumerate(task.sizes.tolist()):
        for arm in range(arms):
            order[arm, block, 1 : size + 1] = rng.permutation(size)
    return order


@dataclass(frozen=True)
class Move:
    """Moves (B, R) of one kind, of the positions ``low`` to ``high``; ``arm`` alone where it is not None."""

    kind: str
    low: NDArray[np.intp]
    high: NDArray[np.intp]
    shift: int
    arm: int | None

    def source(self, position: NDArray[np.intp], rows: tuple[NDArray[np.intp], ...] | None = None) -> NDArray[np.intp]:
        """The present positions of what the move brings to ``position``."""
        low, high = (self.low, self.high) if rows is None else (self.low[rows][:, None], self.high[rows][:, None])
        if self.kind == "exchange":
            return np.where(position == low, high, np.where(position == high, low, position))
        if self.kind == "reverse":
            moved = low + high - position
        else:
            moved = low + (position - low - self.shift) % np.maximum(high - low + 1, 1)
        return np.where((position >= low) & (position <= high), moved, position)

    def changed(self) -> tuple[NDArray[np.intp], ...]:
        """Positions whose step from the position before is another one after the move; each only once."""
        if self.kind == "reverse":
            return self.low, self.high + 1
        if self.kind == "shift":
            return self.low, np.minimum(self.low + self.shift, self.high), self.high + 1
        nothing = np.zeros_like(self.low)
        return self.low, self.low + 1, np.where(self.high > self.low + 1, self.high, nothing), self.high + 1


class _Tours:
    """The orders of all blocks. Positions 1 to size hold stops, position 0 and those beyond an end without cost."""

    def __init__(self, task: TourTask, order: Order) -> None:
        arms, blocks, m, _ = task.time_s.shape
        self._task, self._sizes, self._m, self._order = task, task.sizes, m, order
        self._time = np.pad(task.time_s, ((0, 0), (0, 0), (0, 1), (0, 1)))
        self._pair_cost = np.pad(task.pair_cost, ((0, 0), (0, 0), (0, 1), (0, 1)))
        self._pairs = list(combinations(range(arms), 2))
        self._near = _nearest(task)
        self._block = np.arange(blocks)[:, None]
        self._place = np.zeros((arms, blocks, m + 1), dtype=np.intp)
        self._step_s = np.zeros((blocks, m + 2))
        self._update(np.arange(blocks))
        self._postures = [np.pad(one, ((0, 0), (0, 1), (0, 0))) for one in task.postures]
        ordered = [one[self._block, of_arm] for one, of_arm in zip(self._postures, order, strict=True)]
        total = max(int(self._sizes.sum()), 1)
        self._correlation = [np.einsum("bmp,bmq->pq", ordered[i], ordered[k]) / total for i, k in self._pairs]

    @property
    def inner(self) -> Order:
        """The order without its ends, -1 beyond the size of a block."""
        stops = self._order[:, :, 1:-1]
        return np.where(stops == self._m, -1, stops)

    def step(self, temperature: float, rng: np.random.Generator) -> None:
        """Try many moves of one kind in each block; make the first that is accepted."""
        move = self._propose(rng)
        gain = self._gain(move)
        accepted = gain > temperature * np.log(rng.random(gain.shape))
        accepted &= move.high > move.low
        first = np.argmax(accepted, axis=1)
        blocks = np.flatnonzero(accepted[np.arange(len(first)), first])
        if len(blocks):
            if move.arm is not None:
                self._update_correlation(move, move.arm, blocks, first[blocks])
            source = move.source(np.arange(self._m + 2), (blocks, first[blocks]))
            for arm in range(len(self._order)) if move.arm is None else (move.arm,):
                self._order[arm, blocks] = np.take_along_axis(self._order[arm, blocks], source, axis=1)
            self._update(blocks)

    def _propose(self, rng: np.random.Generator) -> Move:
        arms, blocks = len(self._order), len(self._sizes)
        tries = max(1, _TRIES_AT_ONCE // blocks)
        position = (rng.random((blocks, tries)) * (self._sizes[:, None] + 1)).astype(np.intp)
        if rng.random() < 0.5:
            other = 1 + (rng.random((blocks, tries)) * self._sizes[:, None]).astype(np.intp)
        else:  # the place of a near neighbour of the stop at this position
            arm = int(rng.integers(arms))
            stop = np.minimum(self._order[arm, self._block, position], self._m - 1)
            rank = rng.integers(self._near.shape[3], size=(blocks, tries))
            other = self._place[arm, self._block, self._near[arm, self._block, stop, rank]]
        high = np.maximum(position, other)
        low = np.minimum(np.minimum(position, other) + 1, high)
        draw = rng.random()
        if draw < 0.4:
            return Move("exchange", low, high, 0, int(rng.integers(arms)) if arms > 1 else None)
        if draw < 0.5:
            return Move("exchange", low, high, 0, None)
        if draw < 0.75:
            return Move("reverse", low, high, 0, None)
        return Move("shift", low, high, int(rng.integers(1, _LONGEST_SHIFT + 1)), None)

    def _gain(self, move: Move) -> Array:
        """Time that each move saves (B, R) [s]."""
        gain: Array = np.zeros(move.low.shape)
        for position in move.changed():
            before, here = move.source(np.maximum(position - 1, 0)), move.source(position)
            gain += self._step_s[self._block, position]
            slowest: Array | None = None
            for arm in range(len(self._order)):
                moved = move.arm is None or move.arm == arm
                start = self._order[arm, self._block, before if moved else np.maximum(position - 1, 0)]
                end = self._order[arm, self._block, here if moved else position]
                time_s = self._time[arm, self._block, start, end]
                slowest = time_s if slowest is None else np.maximum(slowest, time_s)
            gain -= np.where(position > 0, slowest, 0.0)
        if move.arm is not None:
            gain += self._saved_on_pairs(move, move.arm)
        return gain

    def _saved_on_pairs(self, move: Move, arm: int) -> Array:
        """Cost of pairs and of correlations that exchanges of stops of one arm save (B, R) [s]."""
        saved: Array = np.zeros(move.low.shape)
        low, high = self._order[:, self._block, move.low], self._order[:, self._block, move.high]
        total = self._sizes.sum()
        unit = self._task.correlation_cost / self._task.correlation_goal**_POWER / total
        for number, other, flipped in self._pairs_of(arm):
            cost, correlation = self._pair_cost[number], self._correlation[number]
            if flipped:
                cost, correlation = cost.transpose(0, 2, 1), correlation.T
            for here, there in ((low, high), (high, low)):
                saved += cost[self._block, here[arm], here[other]] - cost[self._block, there[arm], here[other]]
            own, theirs = (
                self._postures[k][self._block, high[k]] - self._postures[k][self._block, low[k]] for k in (arm, other)
            )
            slope = _POWER * correlation ** (_POWER - 1)
            bend = 0.5 * _POWER * (_POWER - 1) * correlation ** (_POWER - 2)
            saved += unit * np.einsum("brp,brp->br", own @ slope, theirs)
            saved -= unit / total * np.einsum("brp,brp->br", own**2 @ bend, theirs**2)
        return saved

    def _update_correlation(self, move: Move, arm: int, blocks: NDArray[np.intp], tries: NDArray[np.intp]) -> None:
        """Add what the exchanges ``tries`` of some blocks change, before they are made."""
        low, high = (self._order[:, blocks, end[blocks, tries]] for end in (move.low, move.high))
        for number, other, flipped in self._pairs_of(arm):
            own, theirs = (self._postures[k][blocks, high[k]] - self._postures[k][blocks, low[k]] for k in (arm, other))
            less = own.T @ theirs / self._sizes.sum()
            self._correlation[number] -= less.T if flipped else less

    def _pairs_of(self, arm: int) -> Iterator[tuple[int, int, bool]]:
        """Number of each pair with this arm, the other arm, and whether that comes first."""
        for number, pair in enumerate(self._pairs):
            if arm in pair:
                yield number, sum(pair) - arm, pair[1] == arm

    def _update(self, blocks: NDArray[np.intp]) -> None:
        """Compute anew what follows from the order of some blocks."""
        rows = blocks[:, None]
        order = self._order[:, blocks]
        for arm, of_arm in enumerate(order):
            self._place[arm, rows, of_arm[:, 1:-1]] = np.arange(1, self._m + 1)
        arms = np.arange(len(order))[:, None, None]
        self._step_s[rows, np.arange(1, self._m + 2)] = self._time[arms, rows, order[:, :, :-1], order[:, :, 1:]].max(
            axis=0
        )


def _nearest(task: TourTask) -> Order:
    """The nearest stops of each stop (K, B, m, neighbours), nearest first."""
    m = task.time_s.shape[2]
    near = np.where(np.eye(m, dtype=bool), np.inf, task.time_s)
    for block, size in enumerate(task.sizes.tolist()):
        near[:, block, :, size:] = np.inf
    count = max(1, min(_NEIGHBOURS, int(task.sizes.min(initial=m)) - 1))
    return np.argsort(near, axis=3, kind="stable")[..., :count]
