"""Planned factors of each stop: side and size of each joint's last motion, rest before the measurement.

The last motion of all arms goes at once from ``approach_from``: the stop minus a step of each joint with its sign. The
levels are balanced, and decorrelated from posture, time, block, the other arms and each other, so that no effect of a
factor can pass for an effect of another. Repeats of a stop are approached from the other side of every joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.kinematics.transforms import Array
from cellapp.planning.balance import Columns, balanced_levels, posture_functions, standardised, time_and_blocks
from cellapp.profile import Profile
from cellapp.safety.gate import CellBodies

_GOAL = 0.06
"""Correlation at which the search for levels ends: some stops must change theirs later, where the gate refuses."""
_OTHER_PATTERNS = 40
"""Other sides and sizes that are tried for a stop whose approach the gate refuses."""
_SIDES = np.array([-1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Approaches:
    """Signed steps of the last motions, arm -> (n, N) [rad]: the motion ends at the stop. 0: the joint rests."""

    step: Mapping[str, Array]

    def start(self, q: Mapping[str, Array], stop: int) -> dict[str, Array]:
        """Where the last motion to a stop begins, arm -> (N,) [rad]."""
        return {name: q[name][stop] - step[stop] for name, step in self.step.items()}


class FactorPlan:
    """Levels of the factors of n stops in their order, arm -> q (n, N) [rad]."""

    def __init__(
        self,
        profile: Profile,
        cell: CellBodies,
        q: Mapping[str, Array],
        block: NDArray[np.intp],
        repeat_of: NDArray[np.intp],
        rng: np.random.Generator,
    ) -> None:
        self._profile, self._q, self._rng = profile, q, rng
        self._limits = {name: cell.arms[name].limits for name in q}
        self._sizes = np.unique(profile.plan.steps)
        self._repeat_of = repeat_of
        self._first = np.flatnonzero(repeat_of < 0)
        """Stops whose levels are free; those of repeats follow."""
        self._postures = _postures(profile, cell, q)
        self._conditions = time_and_blocks(np.arange(len(block), dtype=np.float64), block)

    def dwell_s(self) -> dict[str, Array]:
        """Rest before measuring at each stop, arm -> (n,) [s]: the same for all arms, which wait for each other."""
        levels = np.unique(self._profile.plan.dwell)
        n = len(self._repeat_of)
        against = _with_constant(self._postures.with_(self._conditions).values)
        chosen = balanced_levels(levels, np.ones((n, len(levels)), dtype=np.bool_), against, self._rng, _GOAL)
        return {name: levels[chosen].copy() for name in self._q}

    def approaches(self) -> Approaches:
        """Balanced sides and sizes of the last motions; only limits are regarded."""
        step = {name: np.zeros_like(q) for name, q in self._q.items()}
        if len(self._sizes) == 0:
            return Approaches(step)
        against = self._postures.with_(self._conditions).values
        joints = [(name, j) for name, q in self._q.items() for j in range(q.shape[1])]
        sides: dict[tuple[str, int], Array] = {}
        for name, j in joints:
            allowed = self._allowed_sides(name, j)
            side = _SIDES[self._levels(_SIDES, allowed, against, mirrored=True)]
            sides[name, j] = self._of_all(np.where(allowed.any(axis=1), side, 0.0), mirrored=True)
            against = np.column_stack([against, sides[name, j]])
        for name, j in joints:
            side = sides[name, j]
            allowed = self._allowed_sizes(name, j, side)
            if len(self._sizes) > 1:
                both = np.concatenate([against, against * side[:, None]], axis=1)
                size = self._sizes[self._levels(self._sizes, allowed, both, mirrored=False)]
                against = np.column_stack(
                    [against, standardised(("",), self._of_all(size, mirrored=False)[:, None]).values]
                )
            else:
                size = np.full(len(self._first), self._sizes[0])
            step[name][:, j] = side * self._of_all(np.where(allowed.any(axis=1), size, 0.0), mirrored=False)
        return Approaches(step)

    def other_patterns(self, approaches: Approaches, stop: int) -> list[dict[str, Array]]:
        """Other signed steps of one stop, arm -> (N,) [rad] within limits, best balanced first."""
        own = np.concatenate([step[stop] for step in approaches.step.values()])
        q = np.concatenate([q[stop] for q in self._q.values()])
        low, high = np.concatenate([self._limits[name] for name in self._q]).T
        shape = _OTHER_PATTERNS, len(own)
        size, side = self._rng.choice(self._sizes, shape), self._rng.choice(_SIDES, shape)
        step = _inside(q, side * size, low, high)
        against = self._postures.with_(self._conditions).values
        present = np.concatenate([one for one in approaches.step.values()], axis=1)
        scale = np.maximum(np.sqrt(np.mean(present**2, axis=0)), 1e-12)
        correlation = against.T @ (present / scale) / len(present)
        after = correlation + against[stop][:, None] * ((step - own) / scale)[:, None, :] / len(present)
        ranked = np.argsort(np.sum(after**6, axis=(1, 2)), kind="stable")
        ends = np.cumsum([rows.shape[1] for rows in self._q.values()])[:-1]
        return [dict(zip(self._q, np.split(step[k], ends), strict=True)) for k in ranked.tolist()]

    def _levels(self, levels: Array, allowed: NDArray[np.bool_], against: Array, *, mirrored: bool) -> NDArray[np.intp]:
        """Levels of the free stops; a repeat has the same one, or the opposite if ``mirrored``."""
        fold = against[self._first].copy()
        place = np.searchsorted(self._first, self._repeat_of)
        for copy in np.flatnonzero(self._repeat_of >= 0).tolist():
            fold[place[copy]] += -against[copy] if mirrored else against[copy]
        fold = np.concatenate([_with_constant(fold) if not mirrored else self._with_free_constant(fold)], axis=1)
        usable = np.where(np.any(allowed, axis=1, keepdims=True), allowed, True)
        return balanced_levels(levels, usable, fold, self._rng, _GOAL)

    def _with_free_constant(self, values: Array) -> Array:
        """With a column that is 1 where a stop is not repeated: a repeat balances the side of its stop."""
        repeated = np.isin(self._first, self._repeat_of)
        return np.column_stack([values, np.where(repeated, 0.0, 1.0)])

    def _of_all(self, values: Array, *, mirrored: bool) -> Array:
        """Values of all stops from those of the free ones (m,)."""
        every = np.zeros(len(self._repeat_of))
        every[self._first] = values
        copies = np.flatnonzero(self._repeat_of >= 0)
        every[copies] = every[self._repeat_of[copies]] * (-1.0 if mirrored else 1.0)
        return every

    def _allowed_sides(self, name: str, joint: int) -> NDArray[np.bool_]:
        """Sides (m, 2) from which the largest step is inside the limits; if none is, any step; repeats from both."""
        low, high = self._limits[name][joint]
        q = self._q[name][self._first, joint]
        repeated = np.isin(self._first, self._repeat_of)

        def inside(size: float) -> NDArray[np.bool_]:
            start = q[:, None] - _SIDES * size
            fits = (start >= low) & (start <= high)
            return np.asarray(np.where(repeated[:, None], fits.all(axis=1, keepdims=True), fits))

        largest, smallest = inside(float(self._sizes[-1])), inside(float(self._sizes[0]))
        return np.asarray(np.where(largest.any(axis=1, keepdims=True), largest, smallest))

    def _allowed_sizes(self, name: str, joint: int, side: Array) -> NDArray[np.bool_]:
        """Sizes (m, L) with which the steps of a stop and of its repeat begin inside the limits."""
        low, high = self._limits[name][joint]
        start = self._q[name][:, joint, None] - side[:, None] * self._sizes
        fits = (start >= low) & (start <= high) & (side != 0.0)[:, None]
        for copy in np.flatnonzero(self._repeat_of >= 0).tolist():
            fits[self._repeat_of[copy]] &= fits[copy]
        return np.asarray(fits[self._first])


def _inside(q: Array, step: Array, low: Array, high: Array) -> Array:
    """Steps (m, N) whose start is inside the limits: others are turned round, or left out."""
    turned = np.where((q - step >= low) & (q - step <= high), step, -step)
    return np.asarray(np.where((q - turned >= low) & (q - turned <= high), turned, 0.0))


def _with_constant(values: Array) -> Array:
    return np.column_stack([values, np.ones(len(values))])


def _postures(profile: Profile, cell: CellBodies, q: Mapping[str, Array]) -> Columns:
    found = [posture_functions(profile, cell, name, rows) for name, rows in q.items()]
    return found[0].with_(*found[1:])
