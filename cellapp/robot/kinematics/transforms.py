"""Rotations and rigid transforms as arrays.

``T_A_B`` (4, 4) maps coordinates of frame B into frame A.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
_TRUSTED = {"assume_valid": True} if tuple(map(int, scipy.__version__.split(".")[:2])) >= (1, 17) else {}
"""Skips the check of matrices, which takes scipy (1.17) five times as long as the conversion: all are rotations."""
_SMALL_ANGLE = 1e-9
"""Angle [rad] below which the left Jacobian of a rotation vector is taken as the identity."""


def rotation_x(angle: float) -> Array:
    """Rotation about x by ``angle`` [rad], shape (3, 3)."""
    return rotation_from_vector((angle, 0.0, 0.0))


def rotation_y(angle: float) -> Array:
    """Rotation about y by ``angle`` [rad], shape (3, 3)."""
    return rotation_from_vector((0.0, angle, 0.0))


def rotation_z(angle: float) -> Array:
    """Rotation about z by ``angle`` [rad], shape (3, 3)."""
    return rotation_from_vector((0.0, 0.0, angle))


def rotation_zyx(z: float, y: float, x: float) -> Array:
    """``rot_z(z) rot_y(y) rot_x(x)`` from yaw, pitch and roll [rad], shape (3, 3)."""
    return np.asarray(rotation_z(z) @ rotation_y(y) @ rotation_x(x))


def zyx_angles(rotation: Array) -> tuple[float, float, float]:
    """Yaw, pitch and roll (z, y, x) [rad] of a rotation (3, 3): ``rot_z(z) rot_y(y) rot_x(x)``, |y| <= pi/2.

    Roll is computed after yaw is removed, so that the three angles reproduce the rotation at gimbal lock too. There
    only the sum or difference of yaw and roll is defined; roll is set to zero. (``Rotation.as_euler`` warns instead.)
    """
    cos_y = math.hypot(rotation[0, 0], rotation[1, 0])
    y = math.atan2(-rotation[2, 0], cos_y)
    if cos_y < 1e-12:
        return math.atan2(-rotation[0, 1], rotation[1, 1]), y, 0.0
    z = math.atan2(rotation[1, 0], rotation[0, 0])
    _, cos_x, minus_sin_x = math.cos(z) * rotation[1] - math.sin(z) * rotation[0]
    return z, y, math.atan2(-minus_sin_x, cos_x)


def rpy_of(rotation: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw [rad] of a rotation (3, 3), as URDF and targets write them."""
    yaw, pitch, roll = zyx_angles(rotation)
    return roll, pitch, yaw


def xyz_of(vector: Array) -> tuple[float, float, float]:
    """x, y, z of a vector (3,), as plain numbers."""
    x, y, z = vector.tolist()
    return x, y, z


def rows_of(matrix: Array) -> tuple[tuple[float, ...], ...]:
    """The rows of a matrix, as plain numbers."""
    return tuple(tuple(row) for row in matrix.tolist())


def rotation_from_vector(vector: ArrayLike) -> Array:
    """Rotation (3, 3) about the direction of ``vector`` (3,) by its length [rad].

    With the vector's cross-product matrix K and the angle t: I + sin(t) / t K + (1 - cos(t)) / t^2 K^2 (Rodrigues). It
    is written out because every start of the program needs it, and scipy's rotations take a third of a second to load.
    """
    x, y, z = np.asarray(vector, dtype=np.float64).tolist()
    angle = math.hypot(x, y, z)
    K = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    first, second = np.sinc(angle / math.pi), 0.5 * np.sinc(0.5 * angle / math.pi) ** 2
    return np.asarray(np.eye(3) + first * K + second * (K @ K))


def rotation_vectors(rotations: Array) -> Array:
    """Rotation vectors (n, 3) [rad], length 0 to pi, of rotations (n, 3, 3)."""
    if len(rotations) == 0:  # some versions of scipy refuse an empty batch
        return np.zeros((0, 3))
    return np.asarray(scipy.spatial.transform.Rotation.from_matrix(rotations, **_TRUSTED).as_rotvec())


def rotations_of(quaternions: ArrayLike) -> Array:
    """Rotations (..., 3, 3) of quaternions (..., 4), scalar first; NaN where a quaternion has NaN."""
    quaternions = np.asarray(quaternions, dtype=np.float64)
    known = np.isfinite(quaternions).all(axis=-1)
    rotations = np.full((*known.shape, 3, 3), np.nan)
    if known.any():  # some versions of scipy refuse an empty batch
        found = scipy.spatial.transform.Rotation.from_quat(quaternions[known], scalar_first=True)
        rotations[known] = found.as_matrix()
    return rotations


def quaternions_of(rotations: Array) -> Array:
    """Unit quaternions (..., 4), scalar first and not negative, of rotations (..., 3, 3); NaN where one has NaN."""
    known = np.isfinite(rotations).all(axis=(-2, -1))
    quaternions = np.full((*known.shape, 4), np.nan)
    if known.any():
        found = scipy.spatial.transform.Rotation.from_matrix(rotations[known])
        quaternions[known] = found.as_quat(canonical=True, scalar_first=True)
    return quaternions


def left_jacobian(vector: Array) -> Array:
    """Compute the rotation in the outer frame per unit of each component of a rotation vector (3,): (3, 3) [rad/rad].

    With the angle t about the unit vector u: ``(sin t / t) I + (1 - sin t / t) u u^T + ((1 - cos t) / t) [u x]``.
    Source: Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol. 2 (2012), section 10.6.
    """
    angle = float(np.linalg.norm(vector))
    if angle < _SMALL_ANGLE:
        return np.eye(3)
    u, share = vector / angle, math.sin(angle) / angle
    across = np.cross(u, np.eye(3)).T
    return np.asarray(share * np.eye(3) + (1.0 - share) * np.outer(u, u) + (1.0 - math.cos(angle)) / angle * across)


def mean_rotation(rotations: Array) -> Array:
    """Rotation (3, 3) nearest to rotations (n, 3, 3) in least squares of their entries."""
    return np.asarray(scipy.spatial.transform.Rotation.from_matrix(rotations).mean().as_matrix())


def transform(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Rigid transform (4, 4) from a rotation (3, 3) and a translation (3,) [m]."""
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = translation
    return result


def invert(T: Array) -> Array:
    """Inverse of a rigid transform (4, 4)."""
    rotation = T[:3, :3].T
    return transform(rotation, -rotation @ T[:3, 3])


def apply(T_A_B: Array, p_B: Array) -> Array:
    """Coordinates (n, 3) in frame A of points ``p_B`` (n, 3) in frame B [m]."""
    result: Array = p_B @ T_A_B[:3, :3].T + T_A_B[:3, 3]
    return result


def rms_length(vectors: Array) -> float:
    """Return the root mean square length of vectors (n, 3)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def angular_rows(R_M_S: Array | None) -> NDArray[np.bool_] | None:
    """Return the mask (n,) of rows with a measured orientation (n, 3, 3), not NaN; None if ``R_M_S`` is None."""
    return None if R_M_S is None else np.asarray(np.isfinite(R_M_S[:, 0, 0]))


def twist_columns(p: Array) -> Array:
    """Compute the motion of points (..., 3) per unit of each twist component, (..., 3, 6).

    Three translations [m/m], then three rotations about the axes at the origin [m/rad].
    """
    columns = np.zeros((*p.shape, 6))
    columns[..., :3] = np.eye(3)
    columns[..., 3:] = np.cross(np.eye(3), p[..., None, :]).swapaxes(-1, -2)
    return columns


def register(p_A: Array, p_B: Array, weights: Array | None = None) -> Array:
    """Fit the ``T_A_B`` (4, 4) that maps points ``p_B`` (n, 3) onto ``p_A`` (n, 3) [m] by weighted least squares.

    ``weights`` (n,) default to one. The result is unique for three or more points that are not on one line.
    Source: Kabsch, Acta Cryst. A32 (1976) 922; the sign of the determinant, which excludes reflections, is from
    Umeyama, IEEE Trans. Pattern Anal. Mach. Intell. 13 (1991) 376.
    """
    w = np.ones(len(p_A)) if weights is None else weights
    w = w / w.sum()
    center_A, center_B = w @ p_A, w @ p_B
    u, _, vt = np.linalg.svd(((p_A - center_A) * w[:, None]).T @ (p_B - center_B))
    rotation = u @ np.diag([1.0, 1.0, math.copysign(1.0, float(np.linalg.det(u @ vt)))]) @ vt
    return transform(rotation, center_A - rotation @ center_B)


# -- Linear interpolation of tables whose rows belong to times or to positions along a path ---------------------------


_Floats = NDArray[np.floating[Any]]


def rows_at(wanted: _Floats, places: _Floats, table: Array) -> Array:
    """Interpolate a ``table`` (n, k), given at increasing ``places`` (n,), at ``wanted`` (m,): rows (m, k).

    Outside the given places the first or last row is returned.
    """
    return np.column_stack([np.interp(wanted, places, column) for column in table.T])
