"""Numerical inverse kinematics by damped least squares, for many poses at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.chain import Geometry, frame_poses
from cellapp.robot.kinematics.transforms import Array, rotation_vectors

_LARGEST_STEP = 0.5
"""Largest change of any joint in one iteration [rad]: beyond it the linearisation of the chain does not hold."""
_DAMPING = (1e-2, 1e-3, 1e-14)
"""Damping per squared error, its upper limit, and its lower limit, which keeps the normal matrix regular."""


@dataclass(frozen=True)
class InverseSolution:
    """Solutions of n poses.

    Attributes
    ----------
    q : array, shape (n, N)
        Joint positions [rad].
    reached : array, shape (n,), bool
        Whether both errors are below the tolerance.
    position_error : array, shape (n,)
        Distance of the SMR centre from the wanted position [m].
    rotation_error : array, shape (n,)
        Angle between the flange and the wanted rotation [rad], 0 to pi.
    """

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
    """Find joint positions that put the SMR at ``position_M`` and orient the flange as ``rotation_M``.

    If a pose cannot be reached (fewer than six joints, a singularity, out of range), the iterate with the smallest
    error is returned and marked as not reached.

    Parameters
    ----------
    geometry : Geometry
    position_M : array, shape (n, 3)
        Wanted SMR centre in the tracker frame [m].
    rotation_M : array, shape (n, 3, 3)
        Wanted rotation of the flange in the tracker frame.
    start : array, shape (n, N)
        Initial joint positions [rad]; they select the branch of the solution.
    tolerance : float
        Largest position error [m] and rotation error [rad] that count as reached.
    max_iterations : int

    Notes
    -----
    Damping grows with the squared error: Nakamura, Hanafusa, J. Dyn. Sys. Meas. Control 108 (1986) 163.
    """
    best, best_error = start.copy(), np.full(len(start), np.inf)
    q, active = start.copy(), np.arange(len(start))
    for _ in range(max_iterations):
        errors, J = errors_and_jacobian(geometry, position_M[active], rotation_M[active], q)
        largest = np.abs(errors).max(axis=1)
        better = largest < best_error[active]
        best[active[better]], best_error[active[better]] = q[better], largest[better]
        unsolved = best_error[active] >= 0.1 * tolerance
        if not unsolved.any():
            break
        active, q = active[unsolved], q[unsolved] + damped_step(J[unsolved], errors[unsolved])
    errors, _ = errors_and_jacobian(geometry, position_M, rotation_M, best)
    position_error, rotation_error = (np.linalg.norm(part, axis=1) for part in (errors[:, :3], errors[:, 3:]))
    reached = (position_error < tolerance) & (rotation_error < tolerance)
    return InverseSolution(best, reached, position_error, rotation_error)


def errors_and_jacobian(geometry: Geometry, position_M: Array, rotation_M: Array, q: Array) -> tuple[Array, Array]:
    """Compute position error [m] and rotation vector [rad] to the wanted pose (n, 6), and the geometric Jacobian
    (n, 6, N)."""
    rotations, origins = frame_poses(geometry, q)
    flange = rotations[-1]
    P = origins[-1] + flange @ geometry.tool
    to_wanted = rotation_vectors(flange.transpose(0, 2, 1) @ rotation_M)  # in the flange frame
    errors = np.concatenate([position_M - P, np.einsum("nab,nb->na", flange, to_wanted)], axis=1)
    axes = rotations[:-1, :, :, 2]
    J = np.concatenate([np.cross(axes, P - origins[:-1]), axes], axis=2).transpose(1, 2, 0)
    return errors, J


def damped_step(J: Array, errors: Array) -> Array:
    """Compute a damped least-squares step (n, N) [rad] of limited size from errors (n, 6) and ``J`` (n, 6, N)."""
    share, most, least = _DAMPING
    damping = np.minimum(most, share * np.einsum("na,na->n", errors, errors)) + least
    A = J.transpose(0, 2, 1) @ J + damping[:, None, None] * np.eye(J.shape[2])
    step = np.linalg.solve(A, J.transpose(0, 2, 1) @ errors[:, :, None])[:, :, 0]
    largest = np.maximum(np.abs(step).max(axis=1), 1e-12)
    return np.asarray(step * np.minimum(1.0, _LARGEST_STEP / largest)[:, None])
