"""Check whether an arm's published geometry explains recorded readings: units, order and signs of joints. No I/O.

A published arm misses measured points by some millimetres; with wrong joint conventions it misses them by decimetres.
Base and tool are unknown, so the best ones are found for each convention: with the base's rotation given, tool and base
position are a linear problem; with the tool given, the base is the rigid alignment of two sets of points (Arun, Huang,
Blostein, IEEE PAMI 9 (1987) 698).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cellapp.robot.kinematics.chain import Geometry, flange_poses
from cellapp.robot.kinematics.transforms import Array

_ROUNDS = 12
_MOST_ROWS = 120
"""Maximum number of rows that are used; more cost time and tell no more about signs."""
_EXPLAINED = 0.02
"""Largest residual, as a share of the points' spread, under the right convention; a wrong one leaves a third."""
_ALIKE = 1.2
"""Ratio of residuals up to which conventions are equal: the last joint's sign may not matter. The simplest is named."""
_CLEARER = 0.3
"""Share of the present residuals that another convention must stay below to be named."""


@dataclass(frozen=True)
class Explained:
    """Rms residual [m] of the published geometry with the best base and tool, and the spread of the points [m]."""

    rms_m: float
    spread_m: float

    @property
    def holds(self) -> bool:
        """Whether the geometry, with this joint convention, explains the readings."""
        return self.rms_m <= _EXPLAINED * self.spread_m


def explained(nominal: Geometry, q: Array, p_M: Array) -> Explained:
    """Compute how well a chain with free base and tool explains points ``p_M`` (n, 3) [m] at ``q`` (n, N) [rad]."""
    q, p_M = _some(q), _some(p_M)
    rotations, origins = flange_poses(nominal, q)
    spread = float(np.sqrt(np.mean(np.sum((p_M - p_M.mean(axis=0)) ** 2, axis=1))))
    tool = np.zeros(3)
    rest = np.empty_like(p_M)
    for _ in range(_ROUNDS):
        R_M_B = _rotation(origins + rotations @ tool, p_M)
        turned = R_M_B @ rotations
        columns = np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], axis=2).reshape(-1, 6)
        wanted = (p_M - origins @ R_M_B.T).reshape(-1)
        solution = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        tool, rest = solution[:3], (wanted - columns @ solution).reshape(-1, 3)
    return Explained(float(np.sqrt(np.mean(np.sum(rest**2, axis=1)))), spread)


def better_reading(nominal: Geometry, q: Array, p_M: Array) -> tuple[str, Explained] | None:
    """Find another joint convention that explains the points, in words; None if none is clearly better.

    Try the signs of all joints, and a third joint that the controller counts from the horizontal.
    """
    now = explained(nominal, q, p_M).rms_m
    tried = [(words, explained(nominal, other, _some(p_M))) for words, other in _readings(_some(q))]
    best = min(one.rms_m for _, one in tried)
    simplest = next(one for one in tried if one[1].rms_m <= _ALIKE * best)
    return simplest if simplest[1].holds and simplest[1].rms_m < _CLEARER * now else None


# -- inside -----------------------------------------------------------------------------------------------------------


def _some(rows: Array) -> Array:
    """Return evenly spread rows, at most ``_MOST_ROWS``."""
    return rows[:: max(1, -(-len(rows) // _MOST_ROWS))]


def _rotation(p: Array, p_M: Array) -> Array:
    """Compute the rotation (3, 3) that best aligns ``p`` with ``p_M``."""
    u, _, v = np.linalg.svd((p_M - p_M.mean(axis=0)).T @ (p - p.mean(axis=0)))
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v)


def _readings(q: Array) -> Iterator[tuple[str, Array]]:
    joints = q.shape[1]
    if joints > 2:
        for sign, words in ((1.0, "+"), (-1.0, "-")):
            coupled = q.copy()
            coupled[:, 2] += sign * q[:, 1]
            yield f"q3 {words} q2 in place of q3", coupled
    for count in range(1, joints + 1):
        for turned in itertools.combinations(range(joints), count):
            signs = np.ones(joints)
            signs[list(turned)] = -1.0
            yield f"{', '.join(f'q{one + 1}' for one in turned)} with the opposite sign", q * signs
