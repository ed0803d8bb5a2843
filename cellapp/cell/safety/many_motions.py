"""The answers of ``refuse_motion`` for many motions, computed in batches and without reasons.

The same samples of the same paths are compared with the same distances. In batches this takes a third of the time: a
single motion spends most of it on calls for a few samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import ArmBodies, Placed, ceiling_clearance, floor_clearance, pair_gaps, place
from cellapp.cell.safety.gate import (
    EVERY,
    STRIDE,
    CellBodies,
    SampledPath,
    gap_on_paths,
    keeps_obstacles,
    may_meet,
    refuse_motion,
    sample_counts,
    sample_spacing,
    within_limits,
)
from cellapp.robot.kinematics.transforms import Array

_AT_ONCE = 100
"""Number of motions in a batch: their samples fit in the cache."""

Bools = NDArray[np.bool_]
Numbers = NDArray[np.intp]
Configuration = Mapping[str, Array]
"""Arm -> joint positions (N,) [rad]."""


class FreeMotions:
    """Cache of what the gate answers about motions in one cell; motions known in advance are checked in batches."""

    def __init__(self, cell: CellBodies) -> None:
        self._cell = cell
        self._known: dict[bytes, bool] = {}

    def ask(self, motions: Iterable[tuple[Configuration, Configuration]]) -> None:
        """Check motions that are likely to be needed, and cache the answers."""
        new = {key: motion for motion in motions if (key := self._key(*motion)) not in self._known}
        if new:
            q_from, q_to = (
                {name: np.array([q[name] for q in ends]) for name in self._cell.arms}
                for ends in zip(*new.values(), strict=True)
            )
            self._known.update(zip(new, free_motions(self._cell, q_from, q_to).tolist(), strict=True))

    def free(self, here: Configuration, there: Configuration) -> bool:
        """Return whether the gate accepts a motion of all arms."""
        key = self._key(here, there)
        if key not in self._known:
            self._known[key] = not refuse_motion(self._cell, here, there)
        return self._known[key]

    def _key(self, here: Configuration, there: Configuration) -> bytes:
        return b"".join(q[name].tobytes() for name in self._cell.arms for q in (here, there))


def free_motions(cell: CellBodies, q_from: Mapping[str, Array], q_to: Mapping[str, Array]) -> Bools:
    """Return whether ``refuse_motion`` is empty for each of n motions of all arms, arm -> (n, N) [rad], shape (n,).

    Raises
    ------
    ValueError
        If the arms are not those of the cell.
    """
    if set(q_from) != set(cell.arms) or set(q_to) != set(cell.arms):
        raise ValueError(f"motions of {', '.join({*q_from, *q_to})} for the arms {', '.join(cell.arms)}")
    free = np.zeros(len(next(iter(q_to.values()))), dtype=np.bool_)
    for first in range(0, len(free), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        free[part] = _free(cell, {k: q[part] for k, q in q_from.items()}, {k: q[part] for k, q in q_to.items()})
    return free


@dataclass(frozen=True, eq=False)
class _Paths:
    """Paths of an arm, as ``SampledPath``, from ``start`` to ``target`` (n, N) [rad] with ``count`` (n,) samples."""

    arm: ArmBodies
    start: Array
    target: Array
    count: Numbers

    def take(self, rows: Numbers) -> _Paths:
        """Select some of the paths, in their order, with those of their bodies that are placed already."""
        if len(rows) == len(self.count):
            return self
        some = _Paths(self.arm, self.start[rows], self.target[rows], self.count[rows])
        if "coarse_bodies" in vars(self):
            kept = np.zeros(len(self.count), dtype=np.bool_)
            kept[rows] = True
            vars(some)["coarse_bodies"] = self.coarse_bodies.take(np.flatnonzero(kept[self.coarse[0]]))
        return some

    def one(self, row: int) -> SampledPath:
        """Return one path as a ``SampledPath``."""
        path = SampledPath(self.arm, self.start[row], self.target[row], int(self.count[row]))
        vars(path)["coarse_bodies"] = self.coarse_bodies.take(slice(*np.searchsorted(self.coarse[0], (row, row + 1))))
        return path

    @cached_property
    def half_step(self) -> Array:
        """Largest motion of each joint from any point to the nearest sample, for each path (n, N) [rad]."""
        return np.asarray(np.abs(self.target - self.start) * (0.5 / (self.count - 1))[:, None])

    @cached_property
    def deviation(self) -> Array:
        """Farthest that a point of any body is from where it is at the nearest sample, for each path (n,) [m]."""
        return np.asarray(self.half_step @ self.arm.levers)

    @cached_property
    def coarse(self) -> tuple[Numbers, Numbers]:
        """Path and index of every ``STRIDE``-th sample and of the last one of all paths, (r,) each."""
        number = -(-(self.count - 1) // STRIDE) + 1
        path = np.repeat(np.arange(len(number)), number)
        place_in_path = np.arange(len(path)) - np.repeat(np.cumsum(number) - number, number)
        return path, np.minimum(STRIDE * place_in_path, self.count[path] - 1)

    @cached_property
    def coarse_bodies(self) -> Placed:
        """The bodies at the coarse samples."""
        return self.placed(*self.coarse)

    def placed(self, path: Numbers, sample: Numbers) -> Placed:
        """Place the bodies at some samples of some paths."""
        last = self.count[path] - 1
        share = np.where(sample == last, 1.0, sample * (1.0 / last))
        return place(self.arm, self.start[path] + share[:, None] * (self.target[path] - self.start[path]))

    def around(self, doubtful: Bools) -> tuple[Numbers, Numbers]:
        """Return path and index of the samples nearest to the ``doubtful`` (r,) ones of the coarse samples."""
        path, sample = (part[doubtful] for part in self.coarse)
        near = np.clip(sample[:, None] + np.arange(-(STRIDE // 2), STRIDE // 2 + 1), 0, self.count[path, None] - 1)
        longest = int(self.count.max())
        both = np.unique(path[:, None] * longest + near)
        return both // longest, both % longest


def _free(cell: CellBodies, q_from: Mapping[str, Array], q_to: Mapping[str, Array]) -> Bools:
    rows = np.arange(len(next(iter(q_to.values()))))
    for name, arm in cell.arms.items():
        possible = within_limits(arm, q_to[name][rows]) & np.isfinite(q_from[name][rows]).all(axis=1)
        rows = rows[possible]
    paths: dict[str, _Paths] = {}
    for name, arm in cell.arms.items():
        start, target = q_from[name][rows], q_to[name][rows]
        of_arm = _Paths(arm, start, target, sample_counts(arm, start, target, sample_spacing(cell)))
        alone = _alone_is_free(cell, of_arm)
        rows, paths = rows[alone], {other: their.take(alone) for other, their in paths.items()}
        paths[name] = of_arm.take(alone)
    apart = np.ones(len(rows), dtype=np.bool_)
    for first, second in combinations(paths.values(), 2):
        left = np.flatnonzero(apart)
        apart[left] = _stay_apart(first.take(left), second.take(left), cell.clearance + cell.apart)
    free = np.zeros(len(next(iter(q_to.values()))), dtype=np.bool_)
    free[rows[apart]] = True
    return free


def _alone_is_free(cell: CellBodies, paths: _Paths) -> Numbers:
    """Return indices of the paths on which an arm is clear of floor, ceiling, itself and obstacles."""
    free = np.arange(len(paths.count))
    for condition in (_keep_heights, _keep_from_themselves):
        free = free[condition(cell, paths.take(free))] if len(free) else free
    if cell.obstacles:
        free = free[np.array([keeps_obstacles(cell, paths.one(row)) for row in free.tolist()], dtype=np.bool_)]
    return free


def _keep_heights(cell: CellBodies, paths: _Paths) -> Bools:
    needed = cell.clearance + paths.deviation

    def heights(bodies: Placed) -> Array:
        return np.minimum(floor_clearance(bodies, cell.floor), ceiling_clearance(bodies, cell.ceiling))

    enough = (needed + STRIDE * paths.deviation)[paths.coarse[0]]
    path, sample = paths.around(~(heights(paths.coarse_bodies) >= enough))
    free = np.ones(len(needed), dtype=np.bool_)
    free[path[~(heights(paths.placed(path, sample)) >= needed[path])]] = False
    return free


def _keep_from_themselves(cell: CellBodies, paths: _Paths) -> Bools:
    i, k = paths.arm.own_pairs
    free = np.ones(len(paths.count), dtype=np.bool_)
    if not len(i):
        return free
    needed = np.maximum(cell.self_clearance, paths.deviation)
    spread = paths.half_step @ paths.arm.pair_levers.T * STRIDE  # (n, p)
    enough = (needed[:, None] + spread)[paths.coarse[0]]
    doubtful = ~(pair_gaps(paths.coarse_bodies, i, k, enough) >= enough)
    path, sample = paths.around(np.any(doubtful, axis=1))
    asked = needed[path, None]
    free[path[~np.all(pair_gaps(paths.placed(path, sample), i, k, asked) >= asked, axis=1)]] = False
    return free


def _stay_apart(first: _Paths, second: _Paths, clearance: float) -> Bools:
    """Return whether two arms keep the clearance on each pair of paths, at any relative speed."""
    needed = clearance + (EVERY + STRIDE) * (first.deviation + second.deviation)
    near = may_meet(first.coarse_bodies, first.coarse[0], second.coarse_bodies, second.coarse[0], needed)
    apart = ~near
    for row in np.flatnonzero(near).tolist():
        gap, allowance = gap_on_paths(first.one(row), second.one(row), clearance)
        apart[row] = gap >= clearance + allowance
    return apart
