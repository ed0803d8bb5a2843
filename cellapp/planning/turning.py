"""Turning the SMR towards the tracker with one joint near the end of the arm."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from cellapp.kinematics.chain import frame_poses
from cellapp.kinematics.transforms import Array
from cellapp.safety.bodies import ArmBodies, place
from cellapp.safety.gate import CellBodies, clear_alone, visible

_LEAST_SINE = 0.25
"""Sine of the angle between a joint's axis and the viewing direction from which on the joint counts as turning it."""
_GRID = math.pi / 18.0 * np.arange(-18, 19)
"""Angles [rad] among which the best is looked for: every 10 degrees of a turn."""
_STEPS = (1.0, 0.06, 0.004)
"""Spacings of the grid, one search after the other around the best so far: at last to 0.04 degrees."""
_SHARES = (1.0, 0.5, 0.25)
"""Shares of the way to the best angle that are tried, where it is not usable."""


def turned_to_tracker(
    cell: CellBodies, name: str, q: Array, *, above: float = 0.0, ranges: Array | None = None
) -> Array:
    """The same configurations with one joint turned, so that the SMR faces the tracker as well as that joint allows.

    The joint is the last one whose axis is not along the SMR's viewing direction: it moves the SMR and the other bodies
    least. For an SMR across the flange axis this is the last joint, for one along it the joint before.

    Parameters
    ----------
    cell : CellBodies
    name : str
        The arm.
    q : array, shape (n, N)
        Joint positions [rad].
    above : float
        Configurations with at most this incidence [rad] stay as they are.
    ranges : array, shape (N, 2), or None
        Where the joint may be turned to [rad]; None: the limits of the arm.

    Returns
    -------
    q : array, shape (n, N)
        Joint positions [rad]; those are unchanged that have no better angle at which the arm is visible and clear.

    Raises
    ------
    ValueError
        If the cell has no tracker.
    """
    if cell.field is None:
        raise ValueError("the cell has no tracker")
    low, high = (cell.arms[name].limits if ranges is None else ranges).T
    joint, cosine = _turning(cell.arms[name], cell.field.T_C_M[:3, 3], q)
    now, best = cosine(np.zeros((len(q), 1)))[:, 0], np.zeros(len(q))
    for step in _STEPS:
        angles = best[:, None] + step * _GRID
        there = q[:, joint, None] + angles
        allowed = (there >= low[joint]) & (there <= high[joint]) | (_GRID == 0)
        place_of_best = np.argmax(np.where(allowed, cosine(angles), -np.inf), axis=1)
        best = angles[np.arange(len(q)), place_of_best]
    turned, remaining = q.copy(), now < math.cos(above)
    for share in _SHARES:
        rows = np.flatnonzero(remaining & (cosine(share * best[:, None])[:, 0] > now))
        tried = q[rows]
        tried[:, joint] += share * best[rows]
        usable = visible(cell, name, tried) & clear_alone(cell, place(cell.arms[name], tried))
        turned[rows[usable]] = tried[usable]
        remaining[rows[usable]] = False
    return turned


def turning_joint(arm: ArmBodies, q: Array) -> int:
    """Index of the last joint that turns the SMR's viewing direction at configurations ``q`` (n, N) [rad]."""
    rotations, _ = frame_poses(arm.geometry, q)
    normal = rotations[-1] @ arm.normal_F
    sine = np.linalg.norm(np.cross(rotations[:-1, :, :, 2], normal), axis=2)
    turning = np.flatnonzero(np.median(sine, axis=1) >= _LEAST_SINE)
    return int(turning[-1]) if len(turning) else 0


def _turning(arm: ArmBodies, tracker: Array, q: Array) -> tuple[int, Callable[[Array], Array]]:
    """The joint that is turned, and the cosine of the incidence (n, g) for its angles (n, g) [rad] from ``q``.

    A vector v of a body that turns by the angle x about the axis z has the product with a fixed vector t
    ``t . v(x) = (t . z) (v . z) + (t . v - (t . z) (v . z)) cos x + t . (z x v) sin x``.
    """
    joint = turning_joint(arm, q)
    rotations, origins = frame_poses(arm.geometry, q)
    z, centre = rotations[joint, :, :, 2], origins[joint]
    t = tracker - centre
    p = origins[-1] + rotations[-1] @ arm.geometry.tool - centre
    normal = rotations[-1] @ arm.normal_F

    def product(v: Array) -> Array:
        along = _dot(t, z) * _dot(v, z)
        return np.stack([along, _dot(t, v) - along, _dot(t, np.cross(z, v))], axis=1)

    towards, apart = product(normal), -2.0 * product(p)
    towards[:, 0] -= _dot(p, normal)
    apart[:, 0] += _dot(t, t) + _dot(p, p)

    def cosine(angles: Array) -> Array:
        c, s = np.cos(angles), np.sin(angles)
        squared = apart[:, :1] + apart[:, 1:2] * c + apart[:, 2:] * s
        return np.asarray((towards[:, :1] + towards[:, 1:2] * c + towards[:, 2:] * s) / np.sqrt(squared))

    return joint, cosine


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("na,na->n", a, b))
