"""Plain D-H rows that describe the same arm as rows with Hayati's angle beta.

A D-H row places both of its frames on the common normal of two joint axes. Between axes that are nearly parallel this
normal lies far from the arm: at a tilt of 1 mrad, hundreds of metres. The rows then hold large d of opposite signs,
which cancel along the chain. The controller of Universal Robots keeps its calibration in this form: the documentation
of ``ur_calibration`` (docs.ros.org, "Calibration correction algorithm") shows an arm with d2 = 439 m and d3 = -446 m.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np

from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array, apply, rotation_z, transform

_PARALLEL = math.sqrt(sys.float_info.epsilon)
"""Tilt [rad] below which two axes count as parallel. An arm of length L loses L times the tilt by this; above it, d of
about L over the tilt costs L times epsilon over the tilt by rounding. Both are below 1e-7 m at the square root."""


def plain_geometry(geometry: Geometry) -> Geometry:
    """Return the same arm with all beta zero: ``smr_positions`` are equal to rounding at every configuration.

    What a row cannot hold is a turn about and a shift along the next joint axis; these commute with that joint's
    rotation and go into theta and d of the next row, and behind the last row into the tool. Flange orientations are
    equal, too, unless the last row has a beta.
    """
    rows = geometry.rows.copy()
    turn = shift = 0.0
    for row in rows:
        row[0] += turn
        row[1] += shift
        row[:], turn, shift = _plain_row(row)
    tool = apply(transform(rotation_z(turn), [0.0, 0.0, shift]), geometry.tool)
    return replace(geometry, rows=rows, tool=tool)


def _plain_row(row: Array) -> tuple[Array, float, float]:
    """A row (5,) without beta, and the turn [rad] about and the shift [m] along its z axis that remain.

    With the row's x axis turned by ``psi`` about its first axis onto the common normal, and ``twist`` between the axes:

        trans(a, 0, d) rot_x(alpha) rot_y(beta)
            = rot_z(psi) trans(a', 0, d') rot_x(twist) trans(0, 0, shift) rot_z(turn)

    Of the two directions of the normal, the one that is closer to the row's x axis is taken.
    """
    theta, d, a, alpha, beta = row.tolist()
    if beta == 0.0:
        return row, 0.0, 0.0
    ca, sa, cb, sb = math.cos(alpha), math.sin(alpha), math.cos(beta), math.sin(beta)
    sine = math.copysign(math.hypot(sb, sa * cb), sa * cb)
    if abs(sine) < _PARALLEL:
        psi, twist, shift = 0.0, math.atan2(0.0, ca * cb), 0.0
    else:
        psi, twist = math.atan2(sb / sine, sa * cb / sine), math.atan2(sine, ca * cb)
        shift = a * math.sin(psi) / sine
    cp, sp, ct = math.cos(psi), math.sin(psi), math.cos(twist)
    x_next = np.array([cb, sa * sb, -ca * sb])
    turn = math.atan2(x_next @ [-sp * ct, cp * ct, math.sin(twist)], x_next @ [cp, sp, 0.0])
    return np.array([theta + psi, d - shift * ct, a * cp, twist, 0.0]), turn, shift
