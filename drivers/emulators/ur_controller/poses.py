"""Poses of flange and tool from standard D-H, as position and rotation vector.

Plain numbers instead of arrays: they are faster for one configuration per control cycle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from drivers.emulators.ur_controller.personality import Rows

Vector = tuple[float, float, float]


class Frame(NamedTuple):
    """Axes ``x``, ``y``, ``z`` and origin ``p`` of one frame, in another."""

    x: Vector
    y: Vector
    z: Vector
    p: Vector


IDENTITY = Frame((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))


def _mix(a: float, u: Vector, b: float, v: Vector) -> Vector:
    return a * u[0] + b * v[0], a * u[1] + b * v[1], a * u[2] + b * v[2]


def _cross(u: Vector, v: Vector) -> Vector:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


def _plus(u: Vector, v: Vector) -> Vector:
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


def chain(rows: Rows, q: Sequence[float]) -> list[Frame]:
    """Return D-H frames 0 to 6 in B at ``q`` (6,), from ``A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha)``."""
    frame = IDENTITY
    frames = [frame]
    for (theta, d, a, alpha), angle in zip(rows, q, strict=True):
        c, s, ca, sa = math.cos(angle + theta), math.sin(angle + theta), math.cos(alpha), math.sin(alpha)
        x, y, z, p = frame
        rotated, side = _mix(c, x, s, y), _mix(-s, x, c, y)
        frame = Frame(rotated, _mix(ca, side, sa, z), _mix(-sa, side, ca, z), _plus(p, _mix(d, z, a, rotated)))
        frames.append(frame)
    return frames


def composed(one: Frame, other: Frame) -> Frame:
    """Return the product ``one * other``."""

    def rotated(v: Vector) -> Vector:
        return _plus(_mix(v[0], one.x, v[1], one.y), _mix(v[2], one.z, 0.0, one.z))

    return Frame(rotated(other.x), rotated(other.y), rotated(other.z), _plus(rotated(other.p), one.p))


def speed(frames: Sequence[Frame], qd: Sequence[float], point: Vector) -> tuple[float, ...]:
    """Return the velocity of a point of the last body and its angular velocity (6,) at joint speeds ``qd`` (6,)."""
    linear = angular = (0.0, 0.0, 0.0)
    for before, rate in zip(frames, qd, strict=False):
        arm = _mix(1.0, point, -1.0, before.p)
        linear = _plus(linear, _mix(rate, _cross(before.z, arm), 0.0, arm))
        angular = _mix(1.0, angular, rate, before.z)
    return *linear, *angular


def frame(pose: Sequence[float]) -> Frame:
    """Return the frame of a pose x, y, z, rx, ry, rz."""
    x, y, z, *about = pose
    angle = math.sqrt(sum(v * v for v in about))
    if angle == 0.0:
        return IDENTITY._replace(p=(x, y, z))
    a, b, c = (v / angle for v in about)
    cosine, sine = math.cos(angle), math.sin(angle)
    rest = 1.0 - cosine
    return Frame(
        (cosine + a * a * rest, a * b * rest + c * sine, a * c * rest - b * sine),
        (a * b * rest - c * sine, cosine + b * b * rest, b * c * rest + a * sine),
        (a * c * rest + b * sine, b * c * rest - a * sine, cosine + c * c * rest),
        (x, y, z),
    )


def pose(frame: Frame) -> tuple[float, ...]:
    """Return the pose x, y, z, rx, ry, rz of a frame; the rotation angle is at most pi.

    Computed from the quaternion's largest component (Shepperd), which is stable at pi too.
    """
    (xx, yx, zx), (xy, yy, zy), (xz, yz, zz), p = frame
    trace = xx + yy + zz
    largest = max(trace, xx, yy, zz)
    if largest == trace:
        w, x, y, z = 1.0 + trace, zy - yz, xz - zx, yx - xy
    elif largest == xx:
        w, x, y, z = zy - yz, 1.0 + 2.0 * xx - trace, xy + yx, xz + zx
    elif largest == yy:
        w, x, y, z = xz - zx, xy + yx, 1.0 + 2.0 * yy - trace, yz + zy
    else:
        w, x, y, z = yx - xy, xz + zx, yz + zy, 1.0 + 2.0 * zz - trace
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 0.0 if sine == 0.0 else 2.0 * math.atan2(sine, w) / sine
    return *p, x * scale, y * scale, z * scale
