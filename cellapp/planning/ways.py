"""Ways that the gate accepts where it refuses the straight one, the shortest in time of those found.

Tried are: one arm after the other; through one position in which some joints of an arm are still where they began,
some already where they end, and some at home; through home; a random tree from both ends in the joint space of all arms
(RRT-Connect: Kuffner, LaValle, ICRA 2000). Every motion of a way has passed ``refuse_motion``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, permutations, product

import numpy as np
from numpy.typing import NDArray

from cellapp.kinematics.transforms import Array
from cellapp.planning.duration import motion_s
from cellapp.planning.planned_stops import Configuration, Route
from cellapp.profile import Profile
from cellapp.safety.bodies import place
from cellapp.safety.cell_bodies import home_positions
from cellapp.safety.gate import CellBodies, refuse_motion, sample_spacing

_MIXTURES = 2500
"""Most positions looked at for an arm: all combinations of start, end and home for up to seven joints."""
_PARTS = (0.25, 0.5, 0.75)
"""Where on a way an arm is looked at alone, before the gate is asked."""
_PASSED_ON = 12
"""Positions of an arm, shortest ways first, that the gate is asked about."""
_MOST_ASKED = 150
"""Ways of one kind that the gate is asked about: a tenth of a second."""
_MOST_ORDERED = 4
"""Arms of which all orders are tried."""
_TREE_NODES = 300
"""Nodes of a random tree before it is given up: about a second."""
_TREE_STEP = 0.6
"""Longest motion of a joint along an edge of the tree [rad]."""


@dataclass(frozen=True, eq=False)
class Way:
    """Motions that lead to a configuration, without the last one, which ends there; and the time of all [s]."""

    legs: Route
    seconds: float


class WayFinder:
    """Finds ways in one cell; what it found blocked is not asked again."""

    def __init__(self, profile: Profile, cell: CellBodies, rng: np.random.Generator) -> None:
        self._profile, self._cell, self._rng = profile, cell, rng
        self._margin = replace(cell, clearance=cell.clearance + 0.25 * sample_spacing(cell))
        self._homes = home_positions(profile)

    def seconds(self, here: Configuration, there: Configuration) -> float:
        """Time of a motion of all arms at once [s]."""
        arms = self._profile.arms
        return max(float(motion_s(arms[name], (there[name] - here[name])[None])[0]) for name in there)

    def find(self, here: Configuration, there: Configuration) -> Way | str:
        """The shortest way found from ``here`` to ``there`` (all arms); the gate's reason if there is none."""
        refusal = refuse_motion(self._cell, here, there)
        if not refusal:
            return Way((), self.seconds(here, there))
        if refuse_motion(self._cell, there, there):
            return refuse_motion(self._cell, there, there)
        for between in (self._short_detours(here, there), self._through_home(here, there)):
            found = self._first_free(here, there, between)
            if found is not None:
                return found
        tree = self._tree(here, there)
        return refusal if tree is None else self._way(here, tree, there)

    def _first_free(
        self, here: Configuration, there: Configuration, between: Iterator[Sequence[Configuration]]
    ) -> Way | None:
        """The shortest way through some of the configurations ``between`` that the gate accepts."""
        timed = [(self._route_s([here, *through, there]), k, through) for k, through in enumerate(between)]
        for _, _, through in sorted(timed, key=lambda one: one[:2])[:_MOST_ASKED]:
            stations = [here, *through, there]
            if not any(refuse_motion(self._cell, first, second) for first, second in pairwise(stations)):
                return self._way(here, through, there)
        return None

    def _way(self, here: Configuration, through: Sequence[Configuration], there: Configuration) -> Way:
        """The way as legs of the arms that move."""
        legs = []
        for before, after in pairwise([here, *through]):
            legs.append({name: q for name, q in after.items() if not np.array_equal(q, before[name])})
        return Way(tuple(leg for leg in legs if leg), self._route_s([here, *through, there]))

    def _route_s(self, stations: Sequence[Configuration]) -> float:
        return sum(self.seconds(before, after) for before, after in pairwise(stations))

    def _short_detours(self, here: Configuration, there: Configuration) -> Iterator[Sequence[Configuration]]:
        """One arm after the other; through one position of arms whose own way is not free."""
        names = list(there)
        if len(names) <= _MOST_ORDERED:
            for order in permutations(names) if len(names) > 1 else ():
                yield [
                    {name: there[name] if name in order[: k + 1] else here[name] for name in names}
                    for k in range(len(names) - 1)
                ]
        vias = {name: self._vias(name, here[name], there[name]) for name in names}
        for name in names:
            others = [other for other in names if other != name]
            for via in vias[name]:
                for late in product((False, True), repeat=len(others)):
                    yield [{name: via, **{o: here[o] if w else there[o] for o, w in zip(others, late, strict=True)}}]
        for both in zip(*vias.values(), strict=False) if len(names) > 1 else ():
            yield [dict(zip(names, both, strict=True))]

    def _vias(self, name: str, start: Array, end: Array) -> list[Array]:
        """Positions (N,) of an arm between two others through which it is clear, shortest ways first."""
        arm = self._profile.arms[name]
        values = np.stack([start, end, self._homes.get(name, 0.5 * (start + end))])
        joints = len(start)
        if 3**joints <= _MIXTURES:
            choice = np.array(list(product(range(3), repeat=joints)))
        else:
            choice = self._rng.integers(3, size=(_MIXTURES, joints))
        q = np.unique(values[choice, np.arange(joints)], axis=0)
        seconds = motion_s(arm, q - start) + motion_s(arm, end - q)
        q = q[np.argsort(seconds, kind="stable")]
        clear = self._clear(name, q)
        for part in _PARTS:
            for other in (start, end):
                rows = np.flatnonzero(clear)
                clear[rows] = self._clear(name, q[rows] + part * (other - q[rows]))
        return list(q[clear][:_PASSED_ON])

    def _clear(self, name: str, q: Array) -> NDArray[np.bool_]:
        from cellapp.safety.gate import clear_alone

        return np.asarray(clear_alone(self._margin, place(self._margin.arms[name], q)))

    def _through_home(self, here: Configuration, there: Configuration) -> Iterator[Sequence[Configuration]]:
        """Through home, there and back at once or one arm after the other; with one arm at home while others move."""
        homes = {name: self._homes.get(name) for name in there}
        if any(q is None for q in homes.values()):
            return
        home: dict[str, Array] = {name: q for name, q in homes.items() if q is not None}
        yield [home]
        away = list(self._one_by_one(here, home))
        back = list(self._one_by_one(home, there))
        for first in ([], *away):
            for second in ([], *back):
                if first or second:
                    yield [*first, home, *second]
        for name in there:
            aside = {**here, name: home[name]}
            yield [aside, {**there, name: home[name]}]

    def _one_by_one(self, here: Configuration, there: Configuration) -> Iterator[list[Configuration]]:
        if 1 < len(there) <= _MOST_ORDERED:
            for order in permutations(there):
                yield [
                    {name: there[name] if name in order[: k + 1] else here[name] for name in there}
                    for k in range(len(there) - 1)
                ]

    def _tree(self, here: Configuration, there: Configuration) -> list[Configuration] | None:
        """Configurations between two others along a random tree that grows from both; None if they do not meet."""
        space = _JointSpace(self._cell, tuple(there))
        trees = [_Tree(space.vector(here)), _Tree(space.vector(there))]
        for number in range(_TREE_NODES):
            grows, meets = (trees[number % 2], trees[1 - number % 2])
            new = grows.extend(space, self._rng.uniform(*space.limits))
            if new is None:
                continue
            reached = meets.connect(space, grows.nodes[new])
            if reached is None:
                continue
            path = [*grows.path(new)[::-1], *meets.path(reached)[1:]]
            path = path if number % 2 == 0 else path[::-1]
            return [space.configuration(q) for q in _shortened(space, path)[1:-1]]
        return None


@dataclass(frozen=True, eq=False)
class _JointSpace:
    """All joints of all arms as one vector."""

    cell: CellBodies
    names: tuple[str, ...]

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lowest and highest position of all joints [rad]."""
        low, high = np.concatenate([self.cell.arms[name].limits for name in self.names]).T
        return low, high

    def vector(self, q: Configuration) -> Array:
        """Joint positions of all arms in a row."""
        return np.concatenate([q[name] for name in self.names])

    def configuration(self, q: Array) -> dict[str, Array]:
        """The opposite of ``vector``."""
        ends = np.cumsum([self.cell.arms[name].geometry.joints for name in self.names])[:-1]
        return dict(zip(self.names, np.split(q, ends), strict=True))

    def is_free(self, here: Array, there: Array) -> bool:
        """Whether the gate accepts the straight way."""
        return not refuse_motion(self.cell, self.configuration(here), self.configuration(there))


class _Tree:
    """Nodes with their parents; the first is the root."""

    def __init__(self, root: Array) -> None:
        self.nodes, self._parents = [root], [-1]

    def extend(self, space: _JointSpace, towards: Array) -> int | None:
        """Number of a new node one step from the nearest one; None if the way is not free."""
        nearest = int(np.argmin(np.abs(np.array(self.nodes) - towards).max(axis=1)))
        way = towards - self.nodes[nearest]
        new = self.nodes[nearest] + way * min(1.0, _TREE_STEP / max(float(np.abs(way).max()), 1e-12))
        if not space.is_free(self.nodes[nearest], new):
            return None
        self.nodes.append(new)
        self._parents.append(nearest)
        return len(self.nodes) - 1

    def connect(self, space: _JointSpace, target: Array) -> int | None:
        """Number of a node at ``target`` to which the tree grew step by step; None if something is in the way."""
        while (new := self.extend(space, target)) is not None:
            if np.array_equal(self.nodes[new], target):
                return new
        return None

    def path(self, node: int) -> list[Array]:
        """From a node to the root."""
        found = []
        while node >= 0:
            found.append(self.nodes[node])
            node = self._parents[node]
        return found


def _shortened(space: _JointSpace, path: list[Array]) -> list[Array]:
    """The path without nodes that can be passed by."""
    kept, here = [path[0]], 0
    while here < len(path) - 1:
        here = next(k for k in range(len(path) - 1, here, -1) if k == here + 1 or space.is_free(path[here], path[k]))
        kept.append(path[here])
    return kept


def free_homes(cell: CellBodies, homes: Mapping[str, Array]) -> Configuration | None:
    """Where the arms are before and after a job; None if not all arms of the cell have a home position."""
    return homes if set(homes) == set(cell.arms) else None
