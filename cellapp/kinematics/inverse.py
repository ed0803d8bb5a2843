"""Inverse kinematics by damped Newton steps, many poses and many starts at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.kinematics.chain import Geometry, frame_poses
from cellapp.kinematics.transforms import Array, rotation_vectors


@dataclass(frozen=True)
class InverseSolution:
    """Joint positions (n, N) [rad], whether each reached its pose, and what is left of position [m] and turn [rad]."""

    q: Array
    reached: NDArray[np.bool_]
    position_error: Array
    rotation_error: Array


def solve_pose(
    geometry: Geometry,
    position_M: Array,
    rotation_M: Array,
    start: Array,
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 60,
) -> InverseSolution:
    """Joint positions that put the SMR at ``position_M`` with the flange turned as ``rotation_M``.

    An arm with fewer than six joints, or at a singularity, gets the nearest it can in the damped sense and is reported
    as not reached.

    Parameters
    ----------
    geometry : Geometry
    position_M : array, shape (n, 3)
        Wanted SMR centre in the tracker frame [m].
    rotation_M : array, shape (n, 3, 3)
        Wanted rotation of the flange in the tracker frame.
    start : array, shape (n, N)
        Where to begin [rad]; the solution found is the one this leads to.
    tolerance : float
        Position [m] and turn [rad] that count as reached.

    Notes
    -----
    Damping as in Nakamura, Hanafusa, J. Dyn. Sys. Meas. Control 108 (1986) 163, growing with the error left.
    """
    q = start.copy()
    joints = geometry.joints
    best, best_error = q.copy(), np.full(len(q), np.inf)
    for _ in range(max_iterations):
        rotations, origins = frame_poses(geometry, q)
        P = origins[-1] + rotations[-1] @ geometry.tool
        off = position_M - P
        turn = np.einsum("nab,nb->na", rotations[-1], _turn_to(rotations[-1], rotation_M))
        error = np.maximum(np.abs(off).max(axis=1), np.abs(turn).max(axis=1))
        better = error < best_error
        best[better], best_error[better] = q[better], error[better]
        if np.all(best_error < 0.1 * tolerance):
            break
        axes = rotations[:joints, :, :, 2]
        J = np.concatenate([np.cross(axes, P - origins[:joints]), axes], axis=2).transpose(1, 2, 0)
        wanted = np.concatenate([off, turn], axis=1)
        damping = np.minimum(1e-3, 1e-2 * np.einsum("na,na->n", wanted, wanted)) + 1e-14
        A = J.transpose(0, 2, 1) @ J + damping[:, None, None] * np.eye(joints)
        step = np.linalg.solve(A, (J.transpose(0, 2, 1) @ wanted[:, :, None]))[:, :, 0]
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
    rotations, origins = frame_poses(geometry, best)
    left = np.linalg.norm(position_M - origins[-1] - rotations[-1] @ geometry.tool, axis=1)
    turned = np.linalg.norm(_turn_to(rotations[-1], rotation_M), axis=1)
    return InverseSolution(best, (left < tolerance) & (turned < tolerance), left, turned)


def _turn_to(now: Array, wanted: Array) -> Array:
    """Rotation vectors (n, 3), in the turned frame, that take ``now`` (n, 3, 3) to ``wanted``."""
    return rotation_vectors(now.transpose(0, 2, 1) @ wanted)
