"""The inter-base transform from distances alone (Bai et al. 2023, section 5 of the method).

With P_L, P_R the SMR positions in their own base frames and D the measured distance between the two SMRs,

    minimise  sum_i (D_i^2 - |P_R,i - (R P_L,i + b)|^2)^2   over R, b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.calibration.identification import TooFewReadings
from cellapp.kinematics.transforms import Array, rotation_from_vector, transform, zyx_angles

PAIR_NAMES = ("x", "y", "z", "theta", "beta", "alpha")


@dataclass(frozen=True)
class PairIdentification:
    """The inter-base transform and how well it is known.

    Attributes
    ----------
    T_R_L : array, shape (4, 4)
        Takes the left base into the right one.
    values : array, shape (6,)
        x, y, z [m] and theta, beta, alpha [rad] of ``trans(x, y, z) rot_z(theta) rot_y(beta) rot_x(alpha)``.
    standard_errors : array, shape (6,)
        Of translation [m] and of small turns about z, y, x of the right base [rad], scaled by the scatter.
    iterations : int
    converged : bool
    scale : float
        Scatter of the distances [m].
    """

    T_R_L: Array
    values: Array
    standard_errors: Array
    iterations: int
    converged: bool
    scale: float


def distances(T_R_L: Array, p_L: Array, p_R: Array) -> Array:
    """Distances (n,) [m] between SMRs known in their own base frames, both (n, 3)."""
    return np.asarray(np.linalg.norm(p_R - (p_L @ T_R_L[:3, :3].T + T_R_L[:3, 3]), axis=1))


def identify_pair(
    start: Array, p_L: Array, p_R: Array, measured: Array, *, tolerance: float = 1e-9, max_iterations: int = 100
) -> PairIdentification:
    """Identify the inter-base transform.

    Parameters
    ----------
    start : array, shape (4, 4)
        A first ``T_R_L``, from the two bases in the tracker frame: distances alone allow a mirror image.
    p_L, p_R : array, shape (n, 3)
        SMR positions, each in its own base frame [m].
    measured : array, shape (n,)
        Measured distances [m].
    tolerance : float
        Largest step [m, rad] at which the iteration ends.

    Raises
    ------
    TooFewReadings
        Fewer than seven stops.
    """
    n = len(measured)
    if n < 7:
        raise TooFewReadings(f"{n} common stops are too few for the inter-base transform; measure at least 7")
    rotation, b = start[:3, :3].copy(), start[:3, 3].copy()
    converged, iterations, damping = False, 0, 0.0
    residual, J = _linearise(rotation, b, p_L, p_R, measured)
    cost = float(residual @ residual)
    while iterations < max_iterations:
        iterations += 1
        A = J.T @ J
        step = np.linalg.solve(A + damping * np.diag(np.diag(A)), J.T @ residual)
        if np.max(np.abs(step)) <= tolerance:
            converged = True
            break
        trial_rotation, trial_b = rotation_from_vector(step[3:]) @ rotation, b + step[:3]
        trial_residual, trial_J = _linearise(trial_rotation, trial_b, p_L, p_R, measured)
        trial_cost = float(trial_residual @ trial_residual)
        if trial_cost > cost * (1.0 + 1e-12):
            damping = max(1e-4, 10.0 * damping)
            if damping > 1e8:
                break
            continue
        damping = 0.0 if damping < 1e-6 else damping / 10.0
        rotation, b, residual, J, cost = trial_rotation, trial_b, trial_residual, trial_J, trial_cost
    T_R_L = transform(rotation, b)
    off = measured - distances(T_R_L, p_L, p_R)
    scale = float(np.sqrt(off @ off / max(1, n - 6)))
    # distances scatter alike, their squares do not: D^2 scatters by 2 D times as much
    inverse = np.linalg.inv(J.T @ J)
    half = inverse @ (J * (2.0 * measured * scale)[:, None]).T
    errors = np.sqrt(np.einsum("kn,kn->k", half, half))
    return PairIdentification(
        T_R_L=T_R_L,
        values=np.concatenate([b, zyx_angles(rotation)]),
        standard_errors=np.concatenate([errors[:3], errors[:2:-1]]),
        iterations=iterations,
        converged=converged,
        scale=scale,
    )


def _linearise(rotation: Array, b: Array, p_L: Array, p_R: Array, measured: Array) -> tuple[Array, Array]:
    """Residuals of the squared distances (n,) and their model's derivatives (n, 6) by b and by a turn before R."""
    turned = p_L @ rotation.T
    d = p_R - turned - b
    J = -2.0 * np.hstack([d, np.cross(turned, d)])
    return measured**2 - np.einsum("na,na->n", d, d), J
