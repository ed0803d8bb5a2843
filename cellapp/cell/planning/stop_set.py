"""The chosen stops of each arm before they are paired: postures, times between stops, pairs that are compatible."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.balance import Columns, posture_functions
from cellapp.cell.planning.duration import motion_s
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.gate import (
    CellBodies,
    clear_alone,
    clear_pairs,
    clear_stops,
    visible_stops,
    with_margin_for_ways,
)
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array

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

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The arms."""
        return tuple(self.q)

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
        return self.way_s([q[there] - q[here] for q, here, there in zip(self.q.values(), start, end, strict=True)])

    def way_s(self, ways: Sequence[Array]) -> Array:
        """Compute the time of the slowest arm for motions (n, N) [rad] of each arm, shape (n,) [s]."""
        times = [motion_s(self.profile.arms[name], way) for name, way in zip(self.names, ways, strict=True)]
        return np.asarray(np.max(times, axis=0))

    def arm_times_s(self, arm: int, rows: Rows) -> Array:
        """Compute the time of an arm alone between all pairs of the stops ``rows`` (m,), shape (m, m) [s].

        Motions on which the arm alone is not clear get the time of a mean step more: a detour costs about that. Motions
        that take longer than a mean step are not checked.
        """
        name, cell = self.names[arm], self.cell_of_ways
        q, m = self.q[name][rows], len(rows)
        i, k = np.triu_indices(m, 1)
        way = q[k] - q[i]
        seconds = motion_s(self.profile.arms[name], way)
        looked_at = seconds < self.usual_step_s  # an order hardly has longer ones
        free = np.ones(len(way), dtype=bool)
        for part in _PARTS_OF_WAY:
            left = np.flatnonzero(free & looked_at)
            free[left] = clear_alone(cell, place(cell.arms[name], q[i[left]] + part * way[left]))
        times: Array = np.zeros((m, m))
        times[i, k] = times[k, i] = seconds + np.where(free, 0.0, self.usual_step_s)
        return times

    def arm_pairs(self) -> Iterator[tuple[int, int]]:
        """Return all pairs of arms."""
        return combinations(range(len(self.q)), 2)

    def compatible_stops(self, first: int, second: int, rows: Rows, partners: Rows) -> NDArray[np.bool_]:
        """Return whether arm ``first`` is clear and visible at ``rows`` (m,) while ``second`` is at ``partners`` (p,).

        Returns
        -------
        array, shape (m, p), bool
        """
        a, b = self.names[first], self.names[second]
        two = replace(self.cell, arms={name: self.cell.arms[name] for name in (a, b)})
        pair = with_margin_for_ways(two, between_arms=True)
        return clear_pairs(pair, (a, self.q[a][rows]), (b, self.q[b][partners]))

    def together(self, rows: Rows) -> NDArray[np.bool_]:
        """Return whether all arms are clear and visible at the stops ``rows`` (K, n), shape (n,) bool."""
        q = self.at(rows)
        return np.asarray(clear_stops(self.cell, q) & visible_stops(self.cell, q))
