"""Paths that the gate accepts where it refuses the straight motion; of those found, the shortest in time.

Candidates: one arm after the other; along the roadmap of an arm, while the others have moved or wait, or of all arms;
through home. The gate has accepted every motion of a path.

Fastest order and pairing of the stops of several arms, block by block, by simulated annealing.

Each arm has the same number of stops in a block. A position of a block's order holds one stop of each arm; a step from
one position to the next takes as long as the slowest arm. Stops that share a position cost as well (``pair_cost``):
this avoids pairs that are not allowed, and correlations between the arms' postures.

Moves for all arms: reverse a part of the order, shift a few positions to another place, or exchange two positions. A
move for one arm: exchange two of its stops, which makes new pairs. Most moves bring a stop beside one of its nearest
neighbours. Many moves of each block are tried at once, and the accepted one with the largest margin is made. At high
temperature this takes a third of the steps that taking the first accepted move does; at low temperature nearly all
moves are refused, so that it is nearly the same as one move after the other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, pairwise, permutations, product
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.cell.planning.planned_stops import Configuration, Route, motion_s
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.safety.gate import CellBodies, FreeMotions, clear_alone, refuse_motion, with_margin_for_ways
from cellapp.ground.profile import Profile
from cellapp.ground.progress import JobToken
from cellapp.robot.kinematics.transforms import Array

_MOST_ASKED = 60
"""Upper limit of the paths that the gate is asked about: less than a tenth of a second."""
_ASKED_TOGETHER = 8
"""Number of these that the gate is asked about at once."""
_MOST_ORDERED = 4
"""Largest number of arms of which all orders are tried."""


class TransitPlanner:
    """Search for paths in one cell."""

    def __init__(self, profile: Profile, cell: CellBodies, rng: np.random.Generator) -> None:
        self.profile, self.cell = profile, cell
        self.gate = FreeMotions(cell)
        """Answers of the gate for all arms; other planning steps share them."""
        self.roadmaps = {name: ArmRoadmap(profile, cell, name, rng) for name in cell.arms}
        """Roadmap of each arm alone."""
        homes = home_positions(profile)
        self.home: Configuration | None = homes if set(homes) == set(cell.arms) else None
        """Home of all arms; None if one of them has none."""

    def find(self, here: Configuration, there: Configuration) -> Route | str:
        """Find the shortest path from ``here`` to ``there`` (all arms); return the gate's reason if there is none.

        The path is without its last motion, which ends there.
        """
        if self.gate.free(here, there):
            return ()
        if no_standing := refuse_motion(self.cell, there, there):
            return no_standing
        ways = [list(pairwise([here, *through, there])) for through in self._between(here, there)]
        shortest = [ways[k] for k in np.argsort(self._ways_s(ways), kind="stable")[:_MOST_ASKED].tolist()]
        for number, way in enumerate(shortest):
            if number % _ASKED_TOGETHER == 0:
                self.gate.ask(motion for other in shortest[number : number + _ASKED_TOGETHER] for motion in other)
            if all(self.gate.free(*motion) for motion in way):
                legs = [_moved(*motion) for motion in way[:-1]]
                return tuple(leg for leg in legs if leg)
        return refuse_motion(self.cell, here, there)

    def _ways_s(self, ways: Sequence[Sequence[tuple[Configuration, Configuration]]]) -> Array:
        """Compute the time of each path (n,) [s]; each motion takes as long as its slowest arm."""
        steps = [step for way in ways for step in way]
        of_arms = [
            motion_s(self.profile.arms[name], np.array([after[name] - before[name] for before, after in steps]))
            for name in steps[0][0]
        ]
        of_way = np.repeat(np.arange(len(ways)), [len(way) for way in ways])
        return np.bincount(of_way, np.max(of_arms, axis=0)).astype(np.float64)

    def _between(self, here: Configuration, there: Configuration) -> Iterator[Sequence[Configuration]]:
        """Yield what may lie between: each order of the arms; paths on their roadmaps; home, with all arms at once or
        one after the other, or with one arm."""
        yield from self._one_after_the_other(here, there)
        paths = {name: self.roadmaps[name].path(here[name], there[name]) or [] for name in there}
        for name, path in paths.items():
            others = [other for other in there if other != name]
            for late in product((False, True), repeat=len(others)) if path else ():
                waiting = {o: (here if waits else there)[o] for o, waits in zip(others, late, strict=True)}
                yield [{name: q, **waiting} for q in path]
        if len(paths) > 1 and len({len(path) for path in paths.values()}) == 1:
            yield [dict(zip(paths, q, strict=True)) for q in zip(*paths.values(), strict=True)]
        home = {name: self.roadmaps[name].rest for name in there}
        for first in ([], *self._one_after_the_other(here, home)):
            for second in ([], *self._one_after_the_other(home, there)):
                yield [*first, home, *second]
        for name in there:
            yield [{**here, name: home[name]}, {**there, name: home[name]}]

    def _one_after_the_other(self, here: Configuration, there: Configuration) -> Iterator[Sequence[Configuration]]:
        """Yield each order of the arms, if there are several and not too many."""
        if 1 < len(there) <= _MOST_ORDERED:
            for order in permutations(there):
                yield [
                    {name: (there if name in order[: k + 1] else here)[name] for name in there}
                    for k in range(len(there) - 1)
                ]


def _moved(before: Configuration, after: Configuration) -> Configuration:
    """Return where those arms are afterwards that move."""
    return {name: q for name, q in after.items() if not np.array_equal(q, before[name])}


# ---------------------------------------------------------------------------------------------------------------------
# The configurations that an arm alone can reach from home, and by which paths: a probabilistic roadmap of each arm.
#
# Source: Kavraki, Svestka, Latombe, Overmars, IEEE Transactions on Robotics and Automation 12 (1996) 566. Motions are
# checked at a few samples only, with a clearance enlarged by what the samples may hide; the gate decides about every
# motion. A configuration that the roadmap does not reach is, with few exceptions, shut off by joint limits, by the arm
# itself or by the cell.


_NODES = 300
"""Nodes of a roadmap besides home: it is built in a quarter of a second."""
_NEIGHBOURS = 12
"""Number of nearest nodes to which a node is connected if the motion is clear."""
_NEAR_ENDS = 60
"""Number of nodes near the ends of a path that are tried as its first and its last."""
_PLACES = (8, 4, 12, 2, 14, 6, 10, 1, 15, 3, 13, 5, 11, 7, 9)
"""Sixteenths of a motion at which an arm is checked, the most selective first."""
_SAMPLES = 40
"""Upper limit of the random configurations sampled for each node."""
_AT_ONCE = 1000
"""Number of configurations whose nearest nodes are found at once."""


class ArmRoadmap:
    """Clear configurations of one arm and the clear motions between them; the first is home."""

    def __init__(self, profile: Profile, cell: CellBodies, name: str, rng: np.random.Generator) -> None:
        self._arm, self._bodies, self._cell = profile.arms[name], cell.arms[name], with_margin_for_ways(cell)
        self._rng = rng
        self._home = None if self._arm.home is None else np.array(self._arm.home)

    @property
    def rest(self) -> Array:
        """Home; for an arm without one, some clear configuration."""
        return self._nodes[0] if self._home is None else self._home

    def reaches(self, q: Array) -> NDArray[np.bool_]:
        """Return whether the arm can go from home to configurations ``q`` (n, N) [rad], without regard to others, (n,).

        For an arm without home: whether they connect to the largest connected part of its roadmap.
        """
        reached: NDArray[np.bool_] = np.zeros(len(q), dtype=np.bool_)
        clear = np.flatnonzero(self._clear(q))
        if self._home is not None:
            reached[clear] = self.clear_ways(np.broadcast_to(self._home, q[clear].shape), q[clear])
        remaining = clear[~reached[clear]]
        for rows in np.array_split(remaining, 1 + len(remaining) // _AT_ONCE) if len(remaining) else ():
            for nodes in self._nearest(q[rows]).T:  # nearest first: it mostly decides
                left = ~reached[rows] & (self._part[nodes] == self._main_part)
                reached[rows[left]] = self.clear_ways(q[rows[left]], self._nodes[nodes[left]])
        return reached

    def path(self, start: Array, end: Array) -> list[Array] | None:
        """Find configurations (N,) between two others, on a path that takes little time; None if there is none."""
        nodes = np.concatenate([self._nodes, start[None], end[None]])
        n = len(nodes)
        near = self._nearest(nodes[-2:], _NEAR_ENDS)
        # both ends to the nodes near them, and to each other
        i = np.append(np.repeat([n - 2, n - 1], near.shape[1]), n - 2)
        k = np.append(near.ravel(), n - 1)
        free = self.clear_ways(nodes[i], nodes[k])
        i, k = np.concatenate([i[free], self._edges[0]]), np.concatenate([k[free], self._edges[1]])
        graph = scipy.sparse.coo_matrix((motion_s(self._arm, nodes[k] - nodes[i]) + 1e-9, (i, k)), shape=(n, n)).tocsr()
        seconds, before = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=n - 2, return_predecessors=True)
        if not np.isfinite(seconds[n - 1]):
            return None
        found, node = [], int(before[n - 1])
        while node != n - 2:
            found.append(nodes[node])
            node = int(before[node])
        return found[::-1]

    def clear_ways(self, start: Array, end: Array) -> NDArray[np.bool_]:
        """Return whether the arm is clear at the samples of motions from ``start`` (n, N) to ``end`` (n, N), (n,)."""
        free = np.ones(len(start), dtype=bool)
        for place_on_way in _PLACES:
            remaining = np.flatnonzero(free)
            share = place_on_way / 16.0
            free[remaining] = self._clear((1.0 - share) * start[remaining] + share * end[remaining])
        return free

    def _clear(self, q: Array) -> NDArray[np.bool_]:
        return np.asarray(clear_alone(self._cell, place(self._bodies, q)))

    @cached_property
    def _nodes(self) -> Array:
        """Home and random clear configurations (m, N) [rad], at most half a turn from home where limits allow that."""
        low, high = self._bodies.limits.T
        centre = 0.5 * (low + high) if self._home is None else self._home
        found = [centre[None]] if self._home is not None else []
        middle = np.clip(centre, np.minimum(low + np.pi, high), np.maximum(high - np.pi, low))
        for _ in range(_SAMPLES):
            if sum(map(len, found)) > _NODES:
                break
            low_here, high_here = np.maximum(low, middle - np.pi), np.minimum(high, middle + np.pi)
            q = self._rng.uniform(low_here, high_here, (_NODES, len(low)))
            found.append(q[self._clear(q)])
        return np.concatenate([*found, centre[None]])[: _NODES + 1]

    @cached_property
    def _edges(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Pairs of nodes that clear motions connect: to the nearest ones, and to home."""
        nodes = self._nodes
        near = self._nearest(nodes)
        i = np.concatenate([np.repeat(np.arange(len(nodes)), near.shape[1]), np.arange(1, len(nodes))])
        k = np.concatenate([near.ravel(), np.zeros(len(nodes) - 1, dtype=np.intp)])
        free = self.clear_ways(nodes[i], nodes[k]) & (i != k)
        return i[free], k[free]

    @cached_property
    def _part(self) -> NDArray[np.intp]:
        """Index of the connected part of each node (m,)."""
        i, k = self._edges
        n = len(self._nodes)
        graph = scipy.sparse.coo_matrix((np.ones(len(i)), (i, k)), shape=(n, n))
        return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1], dtype=np.intp)

    @cached_property
    def _main_part(self) -> int:
        return int(np.argmax(np.bincount(self._part)) if self._home is None else self._part[0])

    def _nearest(self, q: Array, count: int = _NEIGHBOURS) -> NDArray[np.intp]:
        """Return the indices of the nodes nearest in time to each configuration (n, count)."""
        nodes = self._nodes
        way = (nodes[None] - q[:, None]).reshape(-1, q.shape[1])
        seconds = motion_s(self._arm, way).reshape(len(q), len(nodes))
        return np.argsort(seconds, axis=1, kind="stable")[:, :count]


_TOUR_NEIGHBOURS = 10
"""Number of nearest stops beside which a stop is tried."""
_TRIES_AT_ONCE = 512
"""Moves tried in one step, over all blocks: enough that numpy's overhead of a call is small against its work."""
_TRIES_A_STOP = 2
"""Upper limit of the moves tried in one step, for each stop of a block. With more, the best one would nearly always be
a gain, and no temperature would ever accept a loss."""
_HOT, _COLD = 0.04, 0.012
"""First and last temperature, relative to the mean time between two stops. The first order is nearly good: a hotter
start would lose it. At the end only gains are accepted."""
_RANDOM_SHARE = 0.2
"""Share of moves with random positions; the others bring near neighbours together."""
_LONGEST_SHIFT = 3
"""Largest number of positions that are shifted together."""
_POWER = 6
"""Power of the correlations in the cost: the largest dominate, and the effect of one exchange is predicted well."""
_BEND = 0.35 * _POWER * (_POWER - 1)
"""Curvature assumed for that cost within one exchange: less than its initial value, with which exchanges that halve a
correlation would seem to save nothing."""
_CHECK_EVERY = 50
"""Steps between two looks whether the job is cancelled."""

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
        Correlation between variables of two arms that costs ``correlation_cost``; smaller ones cost much less.
    correlation_cost : float
        Cost at the goal [s]; it grows with the power ``_POWER`` of the correlation.
    """

    sizes: NDArray[np.intp]
    time_s: Array
    pair_cost: Array
    postures: Sequence[Array]
    correlation_goal: float
    correlation_cost: float


def best_order(task: TourTask, steps: int, rng: np.random.Generator, job: JobToken) -> Order:
    """Find a fast order (K, B, m) of the stops: their indices within each block, -1 beyond its size.

    Parameters
    ----------
    task : TourTask
    steps : int
        Number of steps; each tries at most ``_TRIES_AT_ONCE`` moves.
    rng : numpy.random.Generator
    job : JobToken
    """
    tours = _Tours(task, _near_order(task, rng))
    scale = float(np.mean(task.time_s)) or 1.0
    temperatures = np.geomspace(_HOT * scale, _COLD * scale, steps) if task.sizes.max(initial=0) > 1 else ()
    for step, temperature in enumerate(temperatures):
        if step % _CHECK_EVERY == 0:
            job.check()
        tours.step(float(temperature), rng)
    return tours.inner


def _near_order(task: TourTask, rng: np.random.Generator) -> Order:
    """Build a first order (K, B, m + 2) of each arm alone: from a random stop always to the nearest one that is left.

    The index m (no stop) stands at the positions before the first and after the last stop.
    """
    arms, blocks, m, _ = task.time_s.shape
    order = np.full((arms, blocks, m + 2), m, dtype=np.intp)
    block = np.arange(blocks)
    for arm in range(arms):
        left_out = np.where(np.arange(m) < task.sizes[:, None], 0.0, np.inf)
        here = (rng.random(blocks) * task.sizes).astype(np.intp)
        for slot in range(1, m + 1):
            going = block[slot <= task.sizes]
            order[arm, going, slot] = here[going]
            left_out[block, here] = np.inf
            here = np.argmin(task.time_s[arm, block, here] + left_out, axis=1)
    return order


Step = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]
"""Current positions: the end of a step that the move removes, then start and end of the step that replaces it."""


@dataclass(frozen=True)
class Move:
    """Moves of one kind on the positions ``low`` to ``high``, of one ``arm`` alone if that is not None.

    ``reverse`` reverses the part; ``shift`` puts its last ``shift`` positions before its others; ``exchange`` exchanges
    its two ends.
    """

    kind: Literal["reverse", "shift", "exchange"]
    low: NDArray[np.intp]
    high: NDArray[np.intp]
    shift: NDArray[np.intp] | int = 0
    arm: int | None = None

    def steps(self) -> tuple[Step, ...]:
        """Return the steps that the move removes, each with the one that replaces it."""
        low, high = self.low, self.high
        if self.kind == "reverse":
            return (low, low - 1, high), (high + 1, low, high + 1)
        if self.kind == "shift":
            cut = high - self.shift
            return (low, low - 1, cut + 1), (cut + 1, high, low), (high + 1, cut, high + 1)
        beside = high == low + 1  # then one step lies between them, not two
        return (
            (low, low - 1, high),
            (low + 1, high, np.where(beside, low, low + 1)),
            (np.where(beside, 0, high), np.where(beside, -1, high - 1), np.where(beside, 0, low)),
            (high + 1, low, high + 1),
        )

    def source(self, position: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the current positions of the stops that the move brings to ``position``."""
        low, high = self.low, self.high
        if self.kind == "exchange":
            return np.where(position == low, high, np.where(position == high, low, position))
        moved = low + high - position
        if self.kind == "shift":
            moved = low + (position - low - self.shift) % (high - low + 1)
        return np.where((position >= low) & (position <= high), moved, position)

    def take(self, rows: tuple[NDArray[np.intp], NDArray[np.intp]]) -> Move:
        """Select some of the moves, each with an axis of its own."""
        shift = self.shift if isinstance(self.shift, int) else self.shift[rows][:, None]
        return Move(self.kind, self.low[rows][:, None], self.high[rows][:, None], shift, self.arm)


class _Tours:
    """The orders of all blocks. Positions 1 to size hold stops; position 0 and those beyond mark an end, without cost.

    Numpy takes from flat arrays much faster than from several axes: positions, stops and pairs of stops are therefore
    indices into flat arrays over all blocks.
    """

    def __init__(self, task: TourTask, order: Order) -> None:
        arms, blocks, m, _ = task.time_s.shape
        self._task, self._sizes, self._m = task, task.sizes[:, None], m
        self._order = order
        """Index within its block of the stop at each position (K, B, m + 2)."""
        self._at = order.reshape(arms, -1)
        self._first = np.arange(blocks)[:, None]
        self._first_pair = self._first * (m + 1) ** 2
        square = ((0, 0), (0, 0), (0, 1), (0, 1))
        self._time = np.pad(task.time_s, square).reshape(arms, blocks * (m + 1) ** 2)
        self._pairs = list(combinations(range(arms), 2))
        self._pair_cost = np.pad(task.pair_cost, square).reshape(len(self._pairs), blocks * (m + 1) ** 2)
        self._postures = [
            np.pad(one, ((0, 0), (0, 1), (0, 0))).reshape(blocks * (m + 1), one.shape[2]) for one in task.postures
        ]
        self._near = _nearest(task).reshape(arms, blocks * m, -1)
        self._place = np.zeros((arms, blocks, m + 1), dtype=np.intp)
        self._step_s = np.zeros((blocks, m + 2))
        self._arm_step_s = np.zeros((arms, blocks, m + 2))
        """Time of the step to each position from the one before it: of the slowest arm, and of each arm."""
        self._update(range(arms), np.arange(blocks))
        self._total = max(int(task.sizes.sum()), 1)
        ordered = [one[self._first * (m + 1) + of_arm] for one, of_arm in zip(self._postures, order, strict=True)]
        self._correlation = [np.einsum("bmp,bmq->pq", ordered[i], ordered[k]) / self._total for i, k in self._pairs]

    @property
    def inner(self) -> Order:
        """The order without its ends, -1 beyond the size of a block."""
        stops = self._order[:, :, 1:-1]
        return np.where(stops == self._m, -1, stops)

    def step(self, temperature: float, rng: np.random.Generator) -> None:
        """Try many moves of one kind in each block; of the accepted ones make the one with the largest margin."""
        move = self._propose(rng)
        spare = self._gain(move) - temperature * np.log(rng.random(move.low.shape))
        spare = np.where(move.high > move.low, spare, 0.0)
        best = np.argmax(spare, axis=1)
        blocks = np.flatnonzero(spare[self._first[:, 0], best] > 0.0)
        if not len(blocks):
            return
        made = move.take((blocks, best[blocks]))
        if made.arm is not None:
            self._update_correlation(made, made.arm, blocks[:, None])
        source = made.source(np.arange(self._m + 2)) + blocks[:, None] * (self._m + 2)
        moved = range(len(self._at)) if made.arm is None else (made.arm,)
        for arm in moved:
            self._order[arm, blocks] = self._at[arm].take(source)
        self._update(moved, blocks)

    def _propose(self, rng: np.random.Generator) -> Move:
        """Propose moves (B, R) that bring two random positions, or a stop and a near neighbour, beside each other."""
        arms, blocks = len(self._at), len(self._sizes)
        shape = blocks, max(1, min(_TRIES_AT_ONCE // blocks, _TRIES_A_STOP * self._m))
        arm = int(rng.integers(arms))
        position = (rng.random(shape) * (self._sizes + 1)).astype(np.intp)
        if rng.random() < _RANDOM_SHARE:
            other = 1 + (rng.random(shape) * self._sizes).astype(np.intp)
        else:
            stop = np.minimum(self._at[arm].take(position + self._first * (self._m + 2)), self._m - 1)
            rank = rng.integers(self._near.shape[2], size=shape)
            near = self._near[arm, stop + self._first * self._m, rank]
            other = self._place[arm].ravel().take(near + self._first * (self._m + 1))
        high = np.maximum(position, other)
        low = np.minimum(np.minimum(position, other) + 1, high)
        sample = rng.random()
        if sample < 0.4:
            return Move("exchange", low, high, arm=arm if arms > 1 else None)
        if sample < 0.5:
            return Move("exchange", low, high)
        if sample < 0.75:
            return Move("reverse", low, high)
        return Move("shift", low, high, np.minimum(int(rng.integers(1, _LONGEST_SHIFT + 1)), high - low))

    def _gain(self, move: Move) -> Array:
        """Compute the time that each move saves (B, R) [s]."""
        steps = np.array(move.steps())  # (steps, 3, B, R)
        steps += self._first * (self._m + 2)
        position, before, here = steps[:, 0], steps[:, 1], steps[:, 2]
        slowest: Array = np.zeros(position.shape)
        for arm, (at, time, step_s) in enumerate(zip(self._at, self._time, self._arm_step_s, strict=True)):
            if move.arm is None or move.arm == arm:
                pairs = at.take(before) * (self._m + 1) + at.take(here) + self._first_pair
                np.maximum(slowest, time.take(pairs), out=slowest)
            else:
                np.maximum(slowest, step_s.ravel().take(position), out=slowest)
        gain: Array = np.zeros(move.low.shape)
        for given_up, taken_up in zip(self._step_s.ravel().take(position), slowest, strict=True):
            gain += given_up
            gain -= taken_up
        if move.arm is not None:
            gain += self._saved_on_pairs(move, move.arm)
        return gain

    def _saved_on_pairs(self, move: Move, arm: int) -> Array:
        """Compute the cost of pairs and of correlations that exchanges of stops of one arm save (B, R) [s]."""
        saved: Array = np.zeros(move.low.shape)
        base, width = self._first * (self._m + 2), self._m + 1
        low, high = ([at.take(base + end) for at in self._at] for end in (move.low, move.high))
        task, pairs = self._task, self._first_pair
        unit = task.correlation_cost / task.correlation_goal**_POWER / self._total
        for number, other, flipped in self._pairs_of(arm):
            cost, correlation = self._pair_cost[number], self._correlation[number]
            own_step, their_step = (1, width) if flipped else (width, 1)
            for own, sign in ((low, 1.0), (high, -1.0)):
                of_own = pairs + own[arm] * own_step
                saved += sign * (
                    cost.take(of_own + low[other] * their_step) - cost.take(of_own + high[other] * their_step)
                )
            own_change, their_change = (self._changes(k, self._first, low[k], high[k]) for k in (arm, other))
            correlation = correlation.T if flipped else correlation
            slope = unit * _POWER * correlation ** (_POWER - 1)
            bend = unit / self._total * _BEND * correlation ** (_POWER - 2)
            p_own, p_their = slope.shape
            own_change, their_change = own_change.reshape(-1, p_own), their_change.reshape(-1, p_their)
            less = np.sum((own_change @ slope - own_change**2 @ bend * their_change) * their_change, axis=1)
            saved += less.reshape(saved.shape)
        return saved

    def _changes(self, arm: int, blocks: NDArray[np.intp], low: NDArray[np.intp], high: NDArray[np.intp]) -> Array:
        """Return the differences of posture between an arm's stops ``high`` and ``low`` in some blocks."""
        first = blocks * (self._m + 1)
        return np.asarray(
            self._postures[arm].take(first + high, axis=0) - self._postures[arm].take(first + low, axis=0)
        )

    def _update_correlation(self, made: Move, arm: int, blocks: NDArray[np.intp]) -> None:
        """Update the correlations for exchanges in some blocks, before these are made."""
        low, high = (self._at[:, blocks * (self._m + 2) + end] for end in (made.low, made.high))
        for number, other, flipped in self._pairs_of(arm):
            own, theirs = (self._changes(k, blocks, low[k], high[k])[:, 0] for k in (arm, other))
            less = own.T @ theirs / self._total
            self._correlation[number] -= less.T if flipped else less

    def _pairs_of(self, arm: int) -> Iterator[tuple[int, int, bool]]:
        """Yield of each pair with this arm: its index, the other arm, and whether the other arm comes first."""
        for number, pair in enumerate(self._pairs):
            if arm in pair:
                yield number, sum(pair) - arm, pair[1] == arm

    def _update(self, arms: Iterable[int], blocks: NDArray[np.intp]) -> None:
        """Recompute what depends on the order of some arms in some blocks."""
        rows, width = blocks[:, None], self._m + 1
        for arm in arms:
            of_arm = self._order[arm, blocks]
            self._place[arm, rows, of_arm[:, 1:-1]] = np.arange(1, width)
            pairs = self._first_pair[blocks] + of_arm[:, :-1] * width + of_arm[:, 1:]
            self._arm_step_s[arm, blocks, 1:] = self._time[arm].take(pairs)
        self._step_s[blocks] = self._arm_step_s[:, blocks].max(axis=0)


def _nearest(task: TourTask) -> Order:
    """Find the nearest stops of each stop (K, B, m, neighbours), nearest first."""
    m = task.time_s.shape[2]
    near = np.where(np.eye(m, dtype=bool), np.inf, task.time_s)
    for block, size in enumerate(task.sizes.tolist()):
        near[:, block, :, size:] = np.inf
    count = max(1, min(_TOUR_NEIGHBOURS, int(task.sizes.min(initial=m)) - 1))
    return np.argsort(near, axis=3, kind="stable")[..., :count]
