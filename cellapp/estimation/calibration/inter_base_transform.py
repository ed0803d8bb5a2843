"""Inter-base transform from distances between the two SMRs alone (Bai et al., ROBOT 45(3) 2023, section 5).

With SMR positions P_L, P_R, each in the base frame of its arm, and measured distances D,

    minimise  sum_i (D_i^2 - |P_R,i - (R P_L,i + b)|^2)^2   over R, b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.estimation.calibration.gauss_newton import LeastSquares
from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.calibration.linear import inverse_psd
from cellapp.robot.kinematics.transforms import Array, rotation_from_vector, transform, zyx_angles

PAIR_NAMES = ("x", "y", "z", "theta", "beta", "alpha")
_TOLERANCE = 1e-9
"""Step size at which the iteration ends [m, rad]."""
_MOST_ITERATIONS = 100
_FEWEST_STOPS = 7
"""Least number of stops: six parameters and one degree of freedom for the scatter."""


@dataclass(frozen=True)
class PairIdentification:
    """The identified inter-base transform and its uncertainty.

    Attributes
    ----------
    T_R_L : array, shape (4, 4)
        Maps coordinates of the left base into the right one.
    values : array, shape (6,)
        x, y, z [m] and theta, beta, alpha [rad] of ``trans(x, y, z) rot_z(theta) rot_y(beta) rot_x(alpha)``.
    standard_errors : array, shape (6,)
        Of the translation [m] and of small rotations about z, y, x of the right base [rad], scaled by ``scale``.
    iterations : int
    scale : float
        Standard deviation of a distance [m].
    """

    T_R_L: Array
    values: Array
    standard_errors: Array
    iterations: int
    scale: float


def distances(T_R_L: Array, p_L: Array, p_R: Array) -> Array:
    """Compute the distances (n,) [m] between the SMRs at ``p_L`` and ``p_R`` (n, 3), each in its own base frame."""
    return np.asarray(np.linalg.norm(p_R - (p_L @ T_R_L[:3, :3].T + T_R_L[:3, 3]), axis=1))


def identify_pair(start: Array, p_L: Array, p_R: Array, measured: Array) -> PairIdentification:
    """Identify the inter-base transform.

    Parameters
    ----------
    start : array, shape (4, 4)
        Initial ``T_R_L`` from both bases in the tracker frame, needed because distances alone also fit a mirror image.
    p_L, p_R : array, shape (n, 3)
        SMR positions, each in its own base frame [m].
    measured : array, shape (n,)
        Measured distances [m].

    Raises
    ------
    TooFewReadings
        For fewer than seven stops.
    NotConverged
    """
    n = len(measured)
    if n < _FEWEST_STOPS:
        raise TooFewReadings(
            f"{n} common stops are too few for the inter-base transform; measure at least {_FEWEST_STOPS}"
        )

    def linearised(T: Array) -> tuple[Array, Array]:
        """Linearise the squared distances [m^2] in b and in a small rotation that is applied after R."""
        rotated = p_L @ T[:3, :3].T
        d = p_R - rotated - T[:3, 3]
        return measured**2 - np.einsum("na,na->n", d, d), -2.0 * np.hstack([d, np.cross(rotated, d)])

    found = LeastSquares(linearised, after_twist).best(
        "inter-base transform from distances", start, tolerance=_TOLERANCE, max_iterations=_MOST_ITERATIONS
    )
    T_R_L = found.point.state
    off = measured - distances(T_R_L, p_L, p_R)
    scale = float(np.sqrt(off @ off / max(1, n - 6)))
    # All distances have the same variance, but their squares do not: D^2 has the standard deviation 2 D scale.
    J = found.point.A
    gain = inverse_psd(J.T @ J) @ (J * (2.0 * measured * scale)[:, None]).T
    errors = np.linalg.norm(gain, axis=1)
    return PairIdentification(
        T_R_L=T_R_L,
        values=np.concatenate([T_R_L[:3, 3], zyx_angles(T_R_L[:3, :3])]),
        standard_errors=np.concatenate([errors[:3], errors[:2:-1]]),
        iterations=len(found.steps),
        scale=scale,
    )


def after_twist(T: Array, step: Array) -> Array:
    """Return T (4, 4) after a shift [m] and a small rotation [rad], applied after T's own, step (6,)."""
    return transform(rotation_from_vector(step[3:]) @ T[:3, :3], T[:3, 3] + step[:3])
