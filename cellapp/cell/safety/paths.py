"""Paths of arms as samples, with bounds on how far a body can be from its position at the nearest sample."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import ArmBodies, Placed, place, segment_distance
from cellapp.robot.kinematics.transforms import Array

EVERY = 2
"""Stride of the samples that are checked against other arms, where all pairs of samples are compared. Other checks use
all samples. The coarser spacing is added to the clearance."""
STRIDE = 8
"""Stride of the coarse samples, which are checked first; a multiple of 2 * ``EVERY``."""


@dataclass(frozen=True, eq=False)
class SampledPath:
    """Evenly spaced samples of one arm's path; no point of a body is farther than ``deviation`` [m] from its nearest.

    Most of a path is far from everything. Therefore every ``STRIDE``-th sample is checked first. Bodies are placed at
    the samples around it only where a body, displaced as far as possible, could come too near.
    """

    arm: ArmBodies
    start: Array
    target: Array
    count: int

    @cached_property
    def half_step(self) -> Array:
        """Largest motion of each joint from any point of the path to the nearest sample, shape (N,) [rad]."""
        return np.asarray(np.abs(self.target - self.start) * (0.5 / (self.count - 1)))

    @cached_property
    def deviation(self) -> float:
        """Largest displacement of any point of a body relative to its place at the nearest sample [m]."""
        return float(self.half_step @ self.arm.levers)

    @cached_property
    def deviations(self) -> Array:
        """``deviation`` of each body, shape (m,) [m]."""
        return np.asarray(self.arm.body_levers @ self.half_step)

    @property
    def spread(self) -> float:
        """Largest displacement of a point of a body at a sample relative to the nearest coarse sample [m]."""
        return STRIDE * self.deviation

    @cached_property
    def coarse(self) -> np.ndarray:
        """Indices of every ``STRIDE``-th sample and of the last one."""
        return np.append(np.arange(0, self.count - 1, STRIDE), self.count - 1)

    @cached_property
    def coarse_bodies(self) -> Placed:
        """The bodies at the coarse samples."""
        return self.placed(self.coarse)

    def placed(self, samples: np.ndarray) -> Placed:
        """Place the bodies at some of the samples."""
        share = np.where(samples == self.count - 1, 1.0, samples * (1.0 / (self.count - 1)))
        return place(self.arm, self.start + share[:, None] * (self.target - self.start))

    def around(self, doubtful: np.ndarray, every: int = 1) -> np.ndarray:
        """Return, of every ``every``-th sample, those nearest to the ``doubtful`` ones (bool) of the coarse samples."""
        near = self.coarse[doubtful][:, None] + np.arange(-(STRIDE // 2), STRIDE // 2 + 1)
        chosen = np.zeros(self.count, dtype=bool)
        chosen[np.clip(near, 0, self.count - 1)] = True
        return np.flatnonzero(chosen[::every]) * every


def sample_path(arm: ArmBodies, start: Array, target: Array, spacing: float) -> SampledPath:
    """Sample a path so that no point of a body moves more than ``spacing`` [m] in ``EVERY`` steps."""
    return SampledPath(arm, start, target, int(sample_counts(arm, start[None], target[None], spacing)[0]))


def sample_counts(arm: ArmBodies, start: Array, target: Array, spacing: float) -> NDArray[np.intp]:
    """Return the number of samples (n,) of n such paths."""
    longest = np.abs(target - start) @ arm.levers
    return np.asarray(EVERY * np.maximum(1, np.ceil(longest / spacing)) + 1, dtype=np.intp)


# -- Distances between two arms, at rest and on paths with any relative speed -----------------------------------------


_PAIRS_AT_ONCE = 20_000
"""Pairs of capsules in a batch: some MB of memory, and an early end at the first collision."""
_ROUNDING_M = 1e-6
"""Tolerance for rounding of distances between spheres, which are computed from squares [m]."""


def gap_at_rest(first: Placed, second: Placed, within: float) -> Array:
    """Compute distances (n,) [m] of two arms at n pairs of configurations; infinite beyond ``within`` [m]."""
    gaps = np.full(len(first.smr), np.inf)
    along = _between_bases(first, second)
    reach_first, reach_second = _reach(first, along), _reach(second, -along)
    # at each pair of configurations, bodies that reach past the other arm's nearest one
    near_first = ~(reach_first + reach_second.max(axis=1, keepdims=True) <= -within)
    near_second = ~(reach_second + reach_first.max(axis=1, keepdims=True) <= -within)
    rows, i, k = np.nonzero(near_first[:, :, None] & near_second[:, None, :])
    for begin in range(0, len(rows), _PAIRS_AT_ONCE):
        batch = slice(begin, begin + _PAIRS_AT_ONCE)
        r, a, b = rows[batch], i[batch], k[batch]
        ends, others = first.axes(r, a), second.axes(r, b)
        between = 0.5 * (ends[0] + ends[1] - others[0] - others[1])
        needed = first.arm.extents[a] + second.arm.extents[b] + within + _ROUNDING_M
        near = ~(np.einsum("cp,cp->p", between, between) > needed * needed)  # also for NaN
        gap = segment_distance(*(end[:, near].T for end in (*ends, *others)))
        np.minimum.at(gaps, r[near], gap - first.radius[a[near]] - second.radius[b[near]])
    return gaps


def gap_on_paths(first: SampledPath, second: SampledPath, clearance: float) -> tuple[float, float]:
    """Compute the distance of two arms at any relative speed on their paths, and the allowance for samples [m].

    The distance is infinite if all pairs of samples keep ``clearance`` plus the allowance; else it is that of a pair
    that does not.
    """
    allowance = EVERY * (first.deviation + second.deviation)
    needed = clearance + allowance
    rows_first, rows_second = _within_reach(
        first.coarse_bodies, second.coarse_bodies, needed + first.spread + second.spread
    )
    if not (rows_first.any() and rows_second.any()):
        return np.inf, allowance
    gap = _first_gap_below(
        first.placed(first.around(np.any(rows_first, axis=1), EVERY)),
        second.placed(second.around(np.any(rows_second, axis=1), EVERY)),
        needed,
    )
    return gap, allowance


def may_meet(
    first: Placed, of_first: NDArray[np.intp], second: Placed, of_second: NDArray[np.intp], within: Array
) -> NDArray[np.bool_]:
    """Return whether two arms, along the line between their bases, come within (n,) [m] on each of n paths, (n,).

    ``of_first`` and ``of_second`` are the paths, in order, to which the bodies of each arm belong. NaN counts as near.
    """
    along = _between_bases(first, second)
    farthest = [
        np.maximum.reduceat(_reach(placed, way).max(axis=1), np.flatnonzero(np.diff(path, prepend=-1)))
        for placed, way, path in ((first, along, of_first), (second, -along, of_second))
        if len(path)
    ]
    return ~(sum(farthest, np.zeros(len(within))) <= -within)


def _between_bases(first: Placed, second: Placed) -> Array:
    """Return the direction from the base of the first arm to that of the second, shape (3,)."""
    along = second.start[0, 0] - first.start[0, 0] if len(first.smr) else np.zeros(3)
    return np.asarray(along / max(float(np.linalg.norm(along)), 1e-12))


def _reach(placed: Placed, along: Array) -> Array:
    """Compute how far bodies reach from the origin along a direction (3,), shape (n, m) [m]."""
    return np.asarray(np.maximum(placed.start @ along, placed.end @ along) + placed.radius)


def _within_reach(first: Placed, second: Placed, clearance: float) -> tuple[np.ndarray, np.ndarray]:
    """Mask the bodies of each arm that reach past the other's nearest one, (n, m) bool each: only these can meet it.

    The extent is along the line between the bases. A NaN counts as within reach.
    """
    along = _between_bases(first, second)
    reach_first, reach_second = _reach(first, along), _reach(second, -along)
    return (
        ~(reach_first + reach_second.max() <= -clearance),
        ~(reach_second + reach_first.max() <= -clearance),
    )


def _first_gap_below(first: Placed, second: Placed, clearance: float) -> float:
    """Return the smallest distance [m] in the first batch that violates the clearance; infinite if none does."""
    near_first, near_second = _within_reach(first, second, clearance)
    i, a = np.nonzero(near_first)
    k, b = np.nonzero(near_second)
    if len(i) == 0 or len(k) == 0:
        return np.inf
    ends, others = first.axes(i, a), second.axes(k, b)
    first_middle, second_middle = 0.5 * (ends[0] + ends[1]), 0.5 * (others[0] + others[1])
    first_square, second_square = np.sum(first_middle**2, axis=0), np.sum(second_middle**2, axis=0)
    extent, other_extent = first.arm.extents[a] + clearance + _ROUNDING_M, second.arm.extents[b]
    block = max(1, _PAIRS_AT_ONCE // len(k))
    for start in range(0, len(i), block):
        part = slice(start, start + block)
        squares = first_square[part, None] + second_square - 2.0 * (first_middle[:, part].T @ second_middle)
        near = ~(squares > (extent[part, None] + other_extent) ** 2)  # by spheres; also for NaN
        one, other = np.nonzero(near)
        if not len(one):
            continue
        one += start
        gap = segment_distance(*(end[:, one].T for end in ends), *(end[:, other].T for end in others))
        smallest = float((gap - first.radius[a[one]] - second.radius[b[other]]).min())
        if not smallest >= clearance:  # also for NaN
            return smallest
    return np.inf
