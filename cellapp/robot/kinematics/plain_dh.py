"""Convert D-H rows with Hayati's angle beta to plain D-H rows of the same arm, and back.

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
from cellapp.robot.kinematics.transforms import Array, apply, rotation_x, rotation_y, rotation_z, transform

_PARALLEL = math.sqrt(sys.float_info.epsilon)
"""Tilt [rad] below which two axes count as parallel. An arm of length L loses L times the tilt by this; above it, d of
about L over the tilt costs L times epsilon over the tilt by rounding. Both are below 1e-7 m at the square root."""

_SAME_ROWS = 2e-6
"""Difference of rows [m, rad] that is rounding: controllers and files say 1.570796327."""
MOST_FACTORY = (10e-3, 20e-3)
FACTORY_SOURCE = "four times the largest of the published calibrations of UR arms (2.2 mm, 3.5 mrad)"
"""Largest length [m] and angle [rad] by which a factory calibration changes published rows, and where that is from:
calibration.conf files in public bug reports of drivers. On the rows of another type the same files differ by at least
14 mm and 96 mrad."""
_NEARLY_PARALLEL = math.sin(math.radians(5.0))
"""Sine of the twist of a published row below which the row has Hayati's angle, as in ``chain``."""


def plain_geometry(geometry: Geometry) -> Geometry:
    """Return the same arm with all beta zero: ``smr_positions`` are equal to rounding at every configuration.

    A plain row leaves a rotation about and a shift along the next joint axis. These commute with that joint's rotation,
    so they are added to theta and d of the next row, and after the last row to the tool. Flange orientations are equal
    too, unless the last row has a beta.
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
    """Convert a row (5,) to one without beta; also return the remaining rotation [rad] about and shift [m] along z.

    With the row's x axis turned by ``psi`` about its first axis onto the common normal, and ``twist`` between the axes:

        trans(a, 0, d) rot_x(alpha) rot_y(beta)
            = rot_z(psi) trans(a', 0, d') rot_x(twist) trans(0, 0, shift) rot_z(turn)

    Of the two directions of the normal, the one closer to the row's x axis is chosen.
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


def hayati_rows(plain: Array, published: Array) -> Array:
    """Convert plain rows (N, 4) to rows (N, 5) with beta of the same arm, near its published rows (N, 4).

    If two published axes are parallel, the row keeps the published d and has a beta, so that no length is large; the
    remaining rotation and shift go into theta and d of the next row, as in ``plain_geometry``. Flange poses are equal.
    """
    rows = np.column_stack([plain, np.zeros(len(plain))])
    turn = shift = 0.0
    for i, row in enumerate(rows):
        row[0] += turn
        row[1] += shift
        turn = shift = 0.0
        if i + 1 < len(rows) and abs(math.sin(published[i, 3])) < _NEARLY_PARALLEL:
            row[:], turn, shift = _hayati_row(row, published[i])
    return rows


def off_published(plain: Array, published: Array) -> Array:
    """Return the differences (N, 5) [rad, m, m, rad, rad] of ``hayati_rows`` from published rows (N, 4)."""
    off = hayati_rows(plain, published) - np.column_stack([published, np.zeros(len(published))])
    off[:, [0, 3]] = np.remainder(off[:, [0, 3]] + np.pi, 2.0 * np.pi) - np.pi
    return off


def of_one_type(plain: Array, published: Array) -> bool:
    """Return whether plain rows (N, 4) are those of one arm of the type with these published rows (N, 4)."""
    if plain.shape != published.shape:
        return False
    off = np.abs(off_published(plain, published))
    return bool(off[:, 1:3].max() <= MOST_FACTORY[0] and off[:, [0, 3, 4]].max() <= MOST_FACTORY[1])


def same_chain(plain: Array, other: Array, published: Array) -> bool:
    """Return whether plain rows (N, 4) and others (N, 4) describe the same arm to rounding, even if d are large."""
    if plain.shape != other.shape:
        return False
    rows = [hayati_rows(one, published) for one in (plain, other)]
    turn = 2.0 * np.pi
    return bool(np.all(np.abs(np.remainder(rows[0] - rows[1] + 0.5 * turn, turn) - 0.5 * turn) < _SAME_ROWS))


def _hayati_row(row: Array, published: Array) -> tuple[Array, float, float]:
    """Convert a plain row (5,) to one with the published d and a beta; also return the remaining rotation [rad] and
    shift [m] about z.

    The next axis intersects the plane z = d at the row's new origin; the x axis goes through that point.
    """
    theta, d, a, alpha = row[:4].tolist()
    c, s = math.cos(theta), math.sin(theta)
    axis = np.array([s * math.sin(alpha), -c * math.sin(alpha), math.cos(alpha)])
    shift = (d - published[1]) / axis[2]
    x, y = np.array([a * c, a * s]) - shift * axis[:2]
    sign = -1.0 if published[2] < 0.0 else 1.0
    theta_new = math.atan2(sign * y, sign * x)
    in_row = rotation_z(-theta_new) @ axis
    beta, alpha_new = math.asin(in_row[0]), math.atan2(-in_row[1], in_row[2])
    left = (rotation_z(theta_new) @ rotation_x(alpha_new) @ rotation_y(beta)).T @ rotation_z(theta) @ rotation_x(alpha)
    turned = np.array([theta_new, published[1], sign * math.hypot(x, y), alpha_new, beta])
    return turned, math.atan2(left[1, 0], left[0, 0]), float(shift)


def plain_rows_of(origins: Array, published: Array) -> Array:
    """Return the plain rows (N, 4) of an arm from its joints' origins (N, 4, 4) in the frames of the links before.

    Each origin is ``rot_z(turn) trans(0, 0, shift) trans(a, 0, 0) rot_x(alpha) trans(0, 0, d) rot_z(theta)``: a and
    alpha are those of the row before, to which turn and shift belong, too. Of the two directions of a common normal,
    that of the ``published`` rows (N, 4) is chosen. What stands before the first joint belongs to the base.
    """
    rows = np.zeros((len(origins) + 1, 4))
    before = np.vstack([np.zeros(4), published])
    for joint, origin in enumerate(origins):
        R, p, a, twist = origin[:3, :3], origin[:3, 3], before[joint, 2], before[joint, 3]
        for sign in (1.0, -1.0):
            sine = sign * math.hypot(R[0, 2], R[1, 2])
            if abs(sine) < _PARALLEL:
                turn = math.atan2(sign * p[1], sign * p[0]) if math.hypot(p[0], p[1]) > _SAME_ROWS else 0.0
                theta, d, alpha = math.atan2(R[1, 0], R[0, 0]) - turn, p[2], 0.0
            else:
                turn, theta = math.atan2(R[0, 2] / sine, -R[1, 2] / sine), math.atan2(R[2, 0] / sine, R[2, 1] / sine)
                alpha = math.atan2(sine, R[2, 2])
                d = (math.sin(turn) * p[0] - math.cos(turn) * p[1]) / sine
            length = math.cos(turn) * p[0] + math.sin(turn) * p[1]
            if (length * a if abs(a) > _SAME_ROWS else alpha * twist) >= 0.0:
                break
        rows[joint] += [turn, p[2] - d * math.cos(alpha), length, alpha]
        rows[joint + 1, :2] += [theta, d]
    rows[1:, 0] -= 2.0 * math.pi * np.rint((rows[1:, 0] - published[:, 0]) / (2.0 * math.pi))
    return rows[1:]
