"""Rotations and rigid transforms as arrays: ``T_A_B`` (4, 4) maps coordinates of frame B into frame A."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def rotation_x(angle: float) -> Array:
    """Rotation about x by ``angle`` [rad], shape (3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle: float) -> Array:
    """Rotation about y by ``angle`` [rad], shape (3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_z(angle: float) -> Array:
    """Rotation about z by ``angle`` [rad], shape (3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_zyx(z: float, y: float, x: float) -> Array:
    """``rot_z(z) rot_y(y) rot_x(x)``, shape (3, 3): yaw, pitch and roll [rad]."""
    return rotation_z(z) @ rotation_y(y) @ rotation_x(x)


def zyx_angles(rotation: Array) -> tuple[float, float, float]:
    """The angles (z, y, x) [rad] with ``rot_z(z) rot_y(y) rot_x(x) = rotation``; |y| <= pi/2."""
    y = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    if math.hypot(rotation[0, 0], rotation[1, 0]) < 1e-12:  # z and x turn about the same line: put all into z
        return math.atan2(-rotation[0, 1], rotation[1, 1]), y, 0.0
    return (
        math.atan2(rotation[1, 0], rotation[0, 0]),
        y,
        math.atan2(rotation[2, 1], rotation[2, 2]),
    )


def rotation_from_vector(vector: ArrayLike) -> Array:
    """Rotation by the length of ``vector`` (3,) [rad] about its direction (Rodrigues), shape (3, 3)."""
    w = np.asarray(vector, dtype=np.float64)
    angle = float(np.linalg.norm(w))
    skew = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    if angle < 1e-8:
        first, second = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0
    else:
        first, second = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
    result: Array = np.eye(3) + first * skew + second * (skew @ skew)
    return result


def rotation_vectors(rotations: Array) -> Array:
    """Rotation vectors (n, 3) [rad] of rotations (n, 3, 3), for angles below pi."""
    axial = 0.5 * np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(axial, axis=1)
    cosine = 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    factor = np.where(sine > 1e-9, angle / np.where(sine > 1e-9, sine, 1.0), 1.0)
    result: Array = axial * factor[:, None]
    return result


def transform(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """``T`` (4, 4) from a rotation (3, 3) and a translation (3,) [m]."""
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = translation
    return result


def invert(T: Array) -> Array:
    """The inverse of a rigid transform (4, 4)."""
    rotation = T[:3, :3].T
    return transform(rotation, -rotation @ T[:3, 3])


def apply(T_A_B: Array, p_B: Array) -> Array:
    """Points (n, 3) of frame B in frame A [m]."""
    result: Array = p_B @ T_A_B[:3, :3].T + T_A_B[:3, 3]
    return result


def register(p_A: Array, p_B: Array, weights: Array | None = None) -> Array:
    """The rigid ``T_A_B`` (4, 4) that brings points ``p_B`` (n, 3) closest to ``p_A`` (n, 3) in least squares.

    Needs three points that are not on one line. Source: Kabsch, Acta Cryst. A32 (1976) 922; Umeyama (1991) for the
    determinant that keeps it a rotation.
    """
    w = np.ones(len(p_A)) if weights is None else weights
    w = w / w.sum()
    center_A, center_B = w @ p_A, w @ p_B
    u, _, vt = np.linalg.svd(((p_A - center_A) * w[:, None]).T @ (p_B - center_B))
    rotation = u @ np.diag([1.0, 1.0, math.copysign(1.0, float(np.linalg.det(u @ vt)))]) @ vt
    return transform(rotation, center_A - rotation @ center_B)
