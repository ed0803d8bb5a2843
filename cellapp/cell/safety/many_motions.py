"""The answers of ``refuse_motion`` for many motions, in batches and without reasons.

In batches this takes a third of the time: a single motion spends most of it on calls for a few samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from cellapp.cell.safety.gate import Bools, CellBodies, checked_motions, refuse_motion
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
        accepted, _ = checked_motions(cell, *({name: q[part] for name, q in ends.items()} for ends in (q_from, q_to)))
        free[first + accepted] = True
    return free
