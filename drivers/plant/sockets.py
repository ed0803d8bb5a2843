"""An arm that is led by hand with the ball of its tool in a fixed socket: the postures that it can take there.

The ball's centre stays in the socket, except for a random seating error at each touch. The joints are what the encoders
read: they are solved from the true arm, deflections included, by least-norm Newton steps with numerical derivatives.
"""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array
from drivers.plant.plant import Plant

_STEP_RAD = 1e-5
"""Step of the numerical derivatives: truncation and rounding errors are below 1e-9 m."""
_ITERATIONS = 60
_SETTLED_M = 1e-8
_LARGEST_RAD = 0.3
"""Largest Newton step of a joint: beyond it the arm is far from linear."""


def touches(
    plant: Plant, arm: str, point_M: Array, starts: Array, *, seating_m: float, rng: np.random.Generator
) -> Array:
    """Return joint readings (k, N) [rad] of an arm whose ball rests in a socket, one for each reachable posture.

    Parameters
    ----------
    point_M : array, shape (3,)
        The socket's centre in the tracker frame [m].
    starts : array, shape (n, N)
        Postures [rad] from which the arm is led to the socket; k <= n of them reach it within the joint limits.
    seating_m : float
        Standard deviation of each coordinate of the ball's seating error [m].
    """
    limits = next(one.limits for one in plant.config.arms if one.name == arm)
    q = np.array(starts, dtype=np.float64)
    wanted = point_M + seating_m * rng.standard_normal((len(q), 3))
    steps = _STEP_RAD * np.eye(q.shape[1])[:, None]
    steps = np.stack([steps, -steps])  # all postures in one call, which costs hardly more than one
    for _ in range(_ITERATIONS):
        off = wanted - _ball(plant, arm, q)
        if float(np.abs(off).max()) < _SETTLED_M:
            break
        moved = _ball(plant, arm, (q + steps).reshape(-1, q.shape[1])).reshape(2, q.shape[1], len(q), 3)
        J = (moved[0] - moved[1]) / (2.0 * _STEP_RAD)
        move = np.einsum("nja,na->nj", np.linalg.pinv(J.transpose(1, 2, 0)), off)
        q += move * np.minimum(1.0, _LARGEST_RAD / np.maximum(np.abs(move).max(axis=1), 1e-12))[:, None]
    there = np.linalg.norm(wanted - _ball(plant, arm, q), axis=1) < 1e3 * _SETTLED_M
    return np.asarray(q[there & np.all((q >= limits[:, 0]) & (q <= limits[:, 1]), axis=1)])


def _ball(plant: Plant, arm: str, q: Array) -> Array:
    """Return true ball centres (n, 3) [m] in M of a hand-led arm, whose gears are in the middle of their play."""
    return plant.smr_positions(arm, q, approach=np.zeros_like(q))
