"""Paths that the gate accepts where it refuses the straight motion; of those found, the shortest in time.

Candidates, in this order: one arm after the other; through positions of an arm, in which each joint is at its start,
its end or its home position, or on the arm's roadmap; through home; a random tree in the joint space of all arms. The
gate has accepted every motion of a path.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, permutations, product

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.cell.planning.duration import motion_s, route_s
from cellapp.cell.planning.planned_stops import Configuration, Route
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.gate import CellBodies, clear_alone, refuse_motion, with_margin_for_ways
from cellapp.cell.safety.many_motions import FreeMotions
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array

_MIXTURES = 2500
"""Most intermediate positions of an arm: all combinations of start, end and home for up to seven joints."""
_LOOKED_AT = 200
"""Number of these, with the shortest detours, that are checked for the arm alone."""
_PASSED_ON = 12
"""Number of clear positions of an arm that the gate is asked about."""
_MOST_ASKED = 60
"""Upper limit of the paths of one kind that the gate is asked about: less than a tenth of a second."""
_ASKED_TOGETHER = 8
"""Number of these that the gate is asked about at once."""
_MOST_ORDERED = 4
"""Largest number of arms of which all orders are tried."""
_TREE_NODES = 300
"""Nodes after which a random tree is given up: less than a second."""
_TREE_STEP = 0.6
"""Longest motion of a joint along an edge of the tree [rad]."""


@dataclass(frozen=True, eq=False)
class TransitPath:
    """The motions to a configuration without the last one, which ends there, and the time of all of them [s]."""

    legs: Route
    seconds: float


class TransitPlanner:
    """Search for paths in one cell."""

    def __init__(self, profile: Profile, cell: CellBodies, rng: np.random.Generator) -> None:
        self._profile, self._cell, self._rng = profile, cell, rng
        self.gate = FreeMotions(cell)
        """Answers of the gate for all arms; other planning steps share them."""
        self.roadmaps = {name: ArmRoadmap(profile, cell, name, rng) for name in cell.arms}
        """Roadmap of each arm alone."""

    def seconds(self, here: Configuration, there: Configuration) -> float:
        """Compute the time of a motion of all arms at once [s]."""
        return route_s(self._profile, here, (there,))

    def find(self, here: Configuration, there: Configuration) -> TransitPath | str:
        """Find the shortest path from ``here`` to ``there`` (all arms); return the gate's reason if there is none."""
        if self.gate.free(here, there):
            return TransitPath((), self.seconds(here, there))
        if no_standing := refuse_motion(self._cell, there, there):
            return no_standing
        for between in (
            self._one_after_the_other(here, there),
            self._short_detours(here, there),
            self._by_home(here, there),
        ):
            found = self._first_free(here, there, between)
            if found is not None:
                return found
        tree = random_tree_path(self._cell, here, there, self._rng)
        return refuse_motion(self._cell, here, there) if tree is None else self._way(here, tree, there)

    def _first_free(
        self, here: Configuration, there: Configuration, between: Iterable[Sequence[Configuration]]
    ) -> TransitPath | None:
        """Find the shortest accepted path through one of the sequences ``between``; None if there is none."""
        ways = [list(pairwise([here, *through, there])) for through in between]
        shortest = [ways[k] for k in np.argsort(self._ways_s(ways), kind="stable")[:_MOST_ASKED].tolist()]
        for number, way in enumerate(shortest):
            if number % _ASKED_TOGETHER == 0:
                self.gate.ask(motion for other in shortest[number : number + _ASKED_TOGETHER] for motion in other)
            if all(self.gate.free(*motion) for motion in way):
                return self._way(here, [end for _, end in way[:-1]], there)
        return None

    def _way(self, here: Configuration, through: Sequence[Configuration], there: Configuration) -> TransitPath:
        """Convert a path to legs, each with the arms that move in it."""
        legs = []
        for before, after in pairwise([here, *through]):
            legs.append({name: q for name, q in after.items() if not np.array_equal(q, before[name])})
        way = list(pairwise([here, *through, there]))
        return TransitPath(tuple(leg for leg in legs if leg), float(self._ways_s([way])[0]))

    def _ways_s(self, ways: Sequence[Sequence[tuple[Configuration, Configuration]]]) -> Array:
        """Compute the time of each path (n,) [s]; each motion takes as long as its slowest arm."""
        steps = [step for way in ways for step in way]
        if not steps:
            return np.zeros(0)
        of_arms = [
            motion_s(self._profile.arms[name], np.array([after[name] - before[name] for before, after in steps]))
            for name in steps[0][0]
        ]
        of_way = np.repeat(np.arange(len(ways)), [len(way) for way in ways])
        return np.bincount(of_way, np.max(of_arms, axis=0)).astype(np.float64)

    def _one_after_the_other(self, here: Configuration, there: Configuration) -> Iterator[Sequence[Configuration]]:
        """Yield each order of the arms, if there are several and not too many."""
        if 1 < len(there) <= _MOST_ORDERED:
            for order in permutations(there):
                yield [
                    {name: (there if name in order[: k + 1] else here)[name] for name in there}
                    for k in range(len(there) - 1)
                ]

    def _short_detours(self, here: Configuration, there: Configuration) -> Iterator[Sequence[Configuration]]:
        """Yield paths through positions of one arm, while the others have moved or wait, and of all arms."""
        alone = {name: self._detours_of_arm(name, here[name], there[name]) for name in there}
        for name, detours in alone.items():
            others = [other for other in there if other != name]
            for through in detours:
                for late in product((False, True), repeat=len(others)):
                    waiting = {o: (here if waits else there)[o] for o, waits in zip(others, late, strict=True)}
                    yield [{name: q, **waiting} for q in through]
        for together in zip(*alone.values(), strict=False) if len(alone) > 1 else ():
            if len({len(through) for through in together}) == 1:
                yield [dict(zip(alone, q, strict=True)) for q in zip(*together, strict=True)]

    def _detours_of_arm(self, name: str, start: Array, end: Array) -> list[list[Array]]:
        """Find short sequences of positions (N,) between ``start`` and ``end`` that keep the arm alone clear."""
        arm, roadmap = self._profile.arms[name], self.roadmaps[name]
        values, joints = np.stack([start, end, roadmap.rest]), len(start)
        if 3**joints <= _MIXTURES:
            choice = np.array(list(product(range(3), repeat=joints)))
        else:
            choice = self._rng.integers(3, size=(_MIXTURES, joints))
        q = np.unique(values[choice, np.arange(joints)], axis=0)
        seconds = motion_s(arm, q - start) + motion_s(arm, end - q)
        q = q[np.argsort(seconds, kind="stable")[:_LOOKED_AT]]
        clear = roadmap.clear_ways(np.broadcast_to(start, q.shape), q) & roadmap.clear_ways(
            q, np.broadcast_to(end, q.shape)
        )
        path = roadmap.path(start, end)
        return [[one] for one in q[clear][:_PASSED_ON]] + ([path] if path else [])

    def _by_home(self, here: Configuration, there: Configuration) -> Iterator[Sequence[Configuration]]:
        """Yield paths through home, all arms at once or one after the other, and with one arm at home meanwhile."""
        home = {name: self.roadmaps[name].rest for name in there}
        for first in ([], *self._one_after_the_other(here, home)):
            for second in ([], *self._one_after_the_other(home, there)):
                yield [*first, home, *second]
        for name in there:
            yield [{**here, name: home[name]}, {**there, name: home[name]}]


def random_tree_path(
    cell: CellBodies, here: Configuration, there: Configuration, rng: np.random.Generator
) -> list[Configuration] | None:
    """Connect two configurations of all arms by random trees grown from both.

    Return the configurations between them; None if no path is found. Source: RRT-Connect, Kuffner, LaValle, ICRA 2000.
    """
    space = _JointSpace(cell, tuple(there))
    trees = _Tree(space.vector(here)), _Tree(space.vector(there))
    low, high = space.limits
    low, high = np.maximum(low, trees[1].nodes[0] - 2.0 * np.pi), np.minimum(high, trees[1].nodes[0] + 2.0 * np.pi)
    for number in range(_TREE_NODES):
        grows, meets = trees[number % 2], trees[1 - number % 2]
        new = grows.extend(space, rng.uniform(low, high))
        reached = None if new is None else meets.connect(space, grows.nodes[new])
        if new is not None and reached is not None:
            path = [*grows.path(new)[::-1], *meets.path(reached)[1:]]
            return [space.configuration(q) for q in _shortened(space, path[:: 1 if number % 2 == 0 else -1])[1:-1]]
    return None


@dataclass(frozen=True, eq=False)
class _JointSpace:
    """The joint space of all arms: their joint positions as one vector."""

    cell: CellBodies
    names: tuple[str, ...]

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lowest and highest position of all joints [rad]."""
        low, high = np.concatenate([self.cell.arms[name].limits for name in self.names]).T
        return low, high

    def vector(self, q: Configuration) -> Array:
        """Concatenate the joint positions of all arms."""
        return np.concatenate([q[name] for name in self.names])

    def configuration(self, q: Array) -> dict[str, Array]:
        """Split a vector into the positions of each arm, the inverse of ``vector``."""
        ends = np.cumsum([self.cell.arms[name].geometry.joints for name in self.names])[:-1]
        return dict(zip(self.names, np.split(q, ends), strict=True))

    def is_free(self, here: Array, there: Array) -> bool:
        """Return whether the gate accepts the straight motion."""
        return not refuse_motion(self.cell, self.configuration(here), self.configuration(there))


class _Tree:
    """Nodes and their parents; the first is the root."""

    def __init__(self, root: Array) -> None:
        self.nodes, self._parents = [root], [-1]

    def extend(self, space: _JointSpace, towards: Array) -> int | None:
        """Add a node one step from the nearest one and return its index; None if the gate refuses the motion."""
        nearest = int(np.argmin(np.abs(np.array(self.nodes) - towards).max(axis=1)))
        way = towards - self.nodes[nearest]
        longest = float(np.abs(way).max())
        new = towards if longest <= _TREE_STEP else self.nodes[nearest] + way * (_TREE_STEP / longest)
        if not space.is_free(self.nodes[nearest], new):
            return None
        self.nodes.append(new)
        self._parents.append(nearest)
        return len(self.nodes) - 1

    def connect(self, space: _JointSpace, target: Array) -> int | None:
        """Grow the tree step by step to ``target`` and return the index of its node; None if the way is blocked."""
        while (new := self.extend(space, target)) is not None:
            if self.nodes[new] is target:
                return new
        return None

    def path(self, node: int) -> list[Array]:
        """Return the nodes from ``node`` to the root."""
        found = []
        while node >= 0:
            found.append(self.nodes[node])
            node = self._parents[node]
        return found


def _shortened(space: _JointSpace, path: list[Array]) -> list[Array]:
    """Remove the nodes that a straight motion can skip."""
    kept, here = [path[0]], 0
    while here < len(path) - 1:
        here = next(k for k in range(len(path) - 1, here, -1) if k == here + 1 or space.is_free(path[here], path[k]))
        kept.append(path[here])
    return kept


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
_PLACES = (8, 4, 12, 2, 14, 6, 10, 1, 15, 3, 13, 5, 11, 7, 9)
"""Sixteenths of a motion at which an arm is checked, the most selective first."""
_DRAWS = 40
"""Upper limit of the random configurations drawn for each node."""
_AT_ONCE = 4000
"""Number of motions that are checked at once."""


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
        left = clear[~reached[clear]]
        for rows in np.array_split(left, 1 + len(left) * _NEIGHBOURS // _AT_ONCE) if len(left) else ():
            near = self._nearest(q[rows])
            free = self.clear_ways(np.repeat(q[rows], near.shape[1], axis=0), self._nodes[near.ravel()])
            reached[rows] = np.any(free.reshape(near.shape) & (self._part[near] == self._main_part), axis=1)
        return reached

    def path(self, start: Array, end: Array) -> list[Array] | None:
        """Find configurations (N,) between two others, on a path that takes little time; None if there is none."""
        nodes = np.concatenate([self._nodes, start[None], end[None]])
        n = len(nodes)
        i = np.append(np.repeat([n - 2, n - 1], n - 2), n - 2)  # both ends to all nodes, and to each other
        k = np.append(np.tile(np.arange(n - 2), 2), n - 1)
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
            left = np.flatnonzero(free)
            share = place_on_way / 16.0
            free[left] = self._clear((1.0 - share) * start[left] + share * end[left])
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
        for _ in range(_DRAWS):
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

    def _nearest(self, q: Array) -> NDArray[np.intp]:
        """Return the indices of the nodes nearest in time to each configuration (n, neighbours)."""
        nodes = self._nodes
        way = (nodes[None] - q[:, None]).reshape(-1, q.shape[1])
        seconds = motion_s(self._arm, way).reshape(len(q), len(nodes))
        return np.argsort(seconds, axis=1, kind="stable")[:, :_NEIGHBOURS]
