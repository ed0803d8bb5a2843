"""Which candidates of an arm can be reached with ease: straight ways from home and from other candidates are free.

Poses that tell most lie at the ends of the joints' ranges, and some of these in pockets (folded, behind an obstacle,
the wrong way round) to which hardly any way leads. Ways are sampled, without regard to other arms; the gate decides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.gate import CellBodies, clear_alone
from cellapp.robot.kinematics.transforms import Array

_HUBS = 8
"""Configurations beside home from which ways are tried."""
_LEAST_WAYS = 2
"""Ways that must be free of those tried: an isolated pose rarely fits into an order of stops."""
_SAMPLES = 10
"""Of a way, without its ends: a tenth of a turn apart on a way of one turn."""
_AT_ONCE = 250
"""Configurations that are placed at once; they fit in the cache."""


def within_reach(cell: CellBodies, name: str, q: Array, hubs: Array) -> NDArray[np.bool_]:
    """Whether configurations ``q`` (n, N) [rad] of an arm can be reached with ease from its ``hubs``, shape (n,)."""
    least = min(_LEAST_WAYS, len(hubs))
    ways = np.zeros(len(q), dtype=np.intp)
    for hub in hubs:
        left = np.flatnonzero(ways < least)
        ways[left] += free_ways(cell, name, hub, q[left])
    return np.asarray(ways >= least)


def hubs_of(cell: CellBodies, name: str, q: Array, home: Array | None) -> Array:
    """Where ways begin (k, N) [rad]: ``home`` (N,), and the first of the configurations ``q`` (n, N), which stand in
    random order, that can be reached from there; without home the first ones."""
    if home is None:
        return q[: _HUBS + 1]
    nearby = q[: 16 * _HUBS]
    return np.concatenate([home[None], nearby[free_ways(cell, name, home, nearby)][:_HUBS]])


def free_ways(cell: CellBodies, name: str, start: Array, q: Array) -> NDArray[np.bool_]:
    """Whether the straight ways from ``start`` (N,) to ``q`` (n, N) [rad] are free at their samples, shape (n,)."""
    free = np.ones(len(q), dtype=np.bool_)
    # the middle first: most ways that are blocked are blocked there
    shares = np.arange(1, _SAMPLES + 1) / (_SAMPLES + 1)
    for share in shares[np.argsort(np.abs(shares - 0.5), kind="stable")]:
        for rows in np.array_split(np.flatnonzero(free), max(1, int(free.sum()) // _AT_ONCE)):
            placed = place(cell.arms[name], start + share * (q[rows] - start))
            free[rows] = clear_alone(cell, placed)
    return free
