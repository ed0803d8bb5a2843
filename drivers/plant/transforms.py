"""Rigid transforms: rotations about lines, small twists. Leading axes are batches; float64."""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array


def cross_matrix(v: Array) -> Array:
    """Return the matrix (..., 3, 3) of the cross product with ``v`` (..., 3)."""
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -v[..., 2], v[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = v[..., 2], -v[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -v[..., 1], v[..., 0]
    return matrix


def rigid(twist: Array) -> Array:
    """Return the transform (..., 4, 4) of a twist: translation ``[..., :3]``, rotation vector ``[..., 3:]``."""
    vector = twist[..., 3:]
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = cross_matrix(vector)
    # sinc keeps both factors of Rodrigues' formula finite at angle zero
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    motion = np.zeros((*vector.shape[:-1], 4, 4))
    motion[..., :3, :3] = np.eye(3) + first * cross + second * (cross @ cross)
    motion[..., :3, 3] = twist[..., :3]
    motion[..., 3, 3] = 1.0
    return motion


def inverse(motion: Array) -> Array:
    """Return the inverse of rigid transforms (..., 4, 4)."""
    back = np.zeros_like(motion)
    rotation = np.swapaxes(motion[..., :3, :3], -1, -2)
    back[..., :3, :3] = rotation
    back[..., :3, 3] = -(rotation @ motion[..., :3, 3, None])[..., 0]
    back[..., 3, 3] = 1.0
    return back


def transform_points(motion: Array, point: Array) -> Array:
    """Return points (..., 3) transformed by rigid transforms (..., 4, 4)."""
    moved: Array = (motion[..., :3, :3] @ point[..., None])[..., 0] + motion[..., :3, 3]
    return moved


def across(direction: Array) -> Array:
    """Return two unit vectors (..., 2, 3) perpendicular to unit vectors ``direction`` (..., 3) and to each other."""
    least = np.argmin(np.abs(direction), axis=-1)
    helper = np.eye(3)[least]
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=-2)


def quaternion(R: Array) -> Array:
    """Return the unit quaternion (4,), scalar first and not negative, of a rotation (3, 3).

    It is the eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric matrix, which is well conditioned for
    every rotation.
    """
    K = np.empty((4, 4))
    K[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
    K[0, 0] = np.trace(R)
    K[0, 1:] = K[1:, 0] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    vector: Array = np.linalg.eigh(K)[1][:, -1]
    return vector if vector[0] >= 0.0 else -vector
