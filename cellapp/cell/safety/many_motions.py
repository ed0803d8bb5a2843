"""The answers of ``refuse_motion`` for many motions, computed in batches and without reasons.

The same samples of the same paths are compared with the same distances. In batches this takes a third of the time: a
single motion spends most of it on calls for a few samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations

import numpy as np

from cellapp.cell.safety.gate import (
    Bools,
    CellBodies,
    Paths,
    alone_free,
    refuse_motion,
    sample_spacing,
    stay_apart,
    within_limits,
)
from cellapp.robot.kinematics.transforms import Array

_AT_ONCE = 100
"""Number of motions in a batch: their samples fit in the cache."""

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


def _free(cell: CellBodies, q_from: Mapping[str, Array], q_to: Mapping[str, Array]) -> Bools:
    rows = np.arange(len(next(iter(q_to.values()))))
    for name, arm in cell.arms.items():
        possible = within_limits(arm, q_to[name][rows]) & np.isfinite(q_from[name][rows]).all(axis=1)
        rows = rows[possible]
    paths: dict[str, Paths] = {}
    for name, arm in cell.arms.items():
        of_arm = Paths.of(arm, q_from[name][rows], q_to[name][rows], sample_spacing(cell))
        alone, _ = alone_free(cell, of_arm)
        rows, paths = rows[alone], {other: their.take(alone) for other, their in paths.items()}
        paths[name] = of_arm.take(alone)
    apart = np.ones(len(rows), dtype=np.bool_)
    for first, second in combinations(paths.values(), 2):
        left = np.flatnonzero(apart)
        apart[left] = stay_apart(first.take(left), second.take(left), cell.clearance + cell.apart)
    free = np.zeros(len(next(iter(q_to.values()))), dtype=np.bool_)
    free[rows[apart]] = True
    return free
