"""An arm that is led by hand with the ball of its tool in a fixed socket: the postures that it can take there.

The ball's centre stays where the socket is, but for how it seats anew each time. The joints are what the encoders then
read: solved from the true arm, deflections included, by least-norm Newton steps with differences as derivatives.
"""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array
from drivers.plant.plant import Plant

_STEP_RAD = 1e-5
"""Step of the differences: truncation and rounding are below 1e-9 m."""
_ITERATIONS = 60
_SETTLED_M = 1e-8
_LARGEST_RAD = 0.3
"""Longest step of a joint: beyond it the arm is not linear at all."""


def touches(
    plant: Plant, arm: str, point_M: Array, starts: Array, *, seating_m: float, rng: np.random.Generator
) -> Array:
    """Joint readings (k, N) [rad] of an arm whose ball rests in a socket, one for each posture that can be reached.

    Parameters
    ----------
    point_M : array, shape (3,)
        The socket's centre in the tracker frame [m].
    starts : array, shape (n, N)
        Postures [rad] from which the arm is led to the socket; k <= n of them reach it within the joint limits.
    seating_m : float
        Standard deviation of a coordinate by which the ball seats anew [m].
    """
    limits = next(one.limits for one in plant.config.arms if one.name == arm)
    q = np.array(starts, dtype=np.float64)
    wanted = point_M + seating_m * rng.standard_normal((len(q), 3))
    steps = _STEP_RAD * np.eye(q.shape[1])[:, None]
    steps = np.stack([steps, -steps])  # of all postures in one call: it costs hardly more than that of one
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
    """True ball centres (n, 3) [m] in M, of a hand-led arm whose gears are in the middle of their play."""
    return plant.smr_positions(arm, q, approach=np.zeros_like(q))
