"""Selection of the candidates of an arm that are easy to reach: straight motions from home and others are free.

The most informative poses lie at the ends of the joints' ranges, and some of these in pockets (folded, behind an
obstacle, the wrong way round) to which hardly any motion leads. Motions are sampled, without regard to other arms; the
gate decides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.gate import CellBodies, clear_alone
from cellapp.robot.kinematics.transforms import Array

_HUBS = 8
"""Number of configurations besides home from which motions are checked."""
_LEAST_WAYS = 2
"""Number of these motions that must be free: an isolated pose rarely fits into an order of stops."""
_SAMPLES = 10
"""Number of samples of a motion, without its ends: a tenth of a turn apart on a motion of one turn."""
_AT_ONCE = 250
"""Number of configurations whose bodies are placed at once; they fit in the cache."""


def within_reach(cell: CellBodies, name: str, q: Array, hubs: Array) -> NDArray[np.bool_]:
    """Return whether an arm reaches configurations ``q`` (n, N) [rad] from enough of its ``hubs``, shape (n,)."""
    least = min(_LEAST_WAYS, len(hubs))
    ways = np.zeros(len(q), dtype=np.intp)
    for hub in hubs:
        left = np.flatnonzero(ways < least)
        ways[left] += free_ways(cell, name, hub, q[left])
    return np.asarray(ways >= least)


def hubs_of(cell: CellBodies, name: str, q: Array, home: Array | None) -> Array:
    """Choose the hubs (k, N) [rad] from which motions are checked: ``home`` (N,), and the first of the configurations
    ``q`` (n, N), in random order, that can be reached from there; without home the first ones."""
    if home is None:
        return q[: _HUBS + 1]
    nearby = q[: 16 * _HUBS]
    return np.concatenate([home[None], nearby[free_ways(cell, name, home, nearby)][:_HUBS]])


def free_ways(cell: CellBodies, name: str, start: Array, q: Array) -> NDArray[np.bool_]:
    """Return whether straight motions from ``start`` (N,) to ``q`` (n, N) [rad] are clear at their samples, (n,)."""
    free = np.ones(len(q), dtype=np.bool_)
    # the middle first: most blocked motions are blocked there
    shares = np.arange(1, _SAMPLES + 1) / (_SAMPLES + 1)
    for share in shares[np.argsort(np.abs(shares - 0.5), kind="stable")]:
        for rows in np.array_split(np.flatnonzero(free), max(1, int(free.sum()) // _AT_ONCE)):
            placed = place(cell.arms[name], start + share * (q[rows] - start))
            free[rows] = clear_alone(cell, placed)
    return free
