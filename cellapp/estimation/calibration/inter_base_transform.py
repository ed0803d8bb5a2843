"""Inter-base transform from distances between the two SMRs alone (Bai et al., ROBOT 45(3) 2023, section 5).

With SMR positions P_L, P_R, each in the base frame of its arm, and measured distances D,

    minimise  sum_i (D_i^2 - |P_R,i - (R P_L,i + b)|^2)^2   over R, b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.estimation.calibration.gauss_newton import damped_step, minimise
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
    converged : bool
    scale : float
        Standard deviation of a distance [m].
    """

    T_R_L: Array
    values: Array
    standard_errors: Array
    iterations: int
    converged: bool
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
    """
    n = len(measured)
    if n < _FEWEST_STOPS:
        raise TooFewReadings(
            f"{n} common stops are too few for the inter-base transform; measure at least {_FEWEST_STOPS}"
        )
    problem = _Problem(p_L, p_R, measured)
    first = problem.estimate(start[:3, :3], start[:3, 3])
    minimum = minimise(problem, first, tolerance=_TOLERANCE, max_iterations=_MOST_ITERATIONS)
    found = minimum.point
    T_R_L = transform(found.rotation, found.translation)
    off = measured - distances(T_R_L, p_L, p_R)
    scale = float(np.sqrt(off @ off / max(1, n - 6)))
    # All distances have the same variance, but their squares do not: D^2 has the standard deviation 2 D scale.
    J = found.J
    gain = inverse_psd(J.T @ J) @ (J * (2.0 * measured * scale)[:, None]).T
    errors = np.linalg.norm(gain, axis=1)
    return PairIdentification(
        T_R_L=T_R_L,
        values=np.concatenate([found.translation, zyx_angles(found.rotation)]),
        standard_errors=np.concatenate([errors[:3], errors[:2:-1]]),
        iterations=len(minimum.steps),
        converged=minimum.converged,
        scale=scale,
    )


@dataclass(frozen=True)
class _Estimate:
    """R (3, 3) and b (3,) [m], the residuals (n,) [m^2] of the squared distances and their Jacobian (n, 6)."""

    rotation: Array
    translation: Array
    residuals: Array
    J: Array


@dataclass(frozen=True)
class _Problem:
    """The least-squares problem of ``identify_pair``, for ``gauss_newton.minimise``."""

    p_L: Array
    p_R: Array
    measured: Array

    def estimate(self, rotation: Array, translation: Array) -> _Estimate:
        """Linearise in b and in a small rotation that is applied after R."""
        rotated = self.p_L @ rotation.T
        d = self.p_R - rotated - translation
        J = -2.0 * np.hstack([d, np.cross(rotated, d)])
        return _Estimate(rotation, translation, self.measured**2 - np.einsum("na,na->n", d, d), J)

    def reweighted(self, point: _Estimate) -> _Estimate:
        return point

    def step(self, point: _Estimate, damping: float) -> tuple[Array, Array]:
        step = damped_step(point.J.T @ point.J, point.J.T @ point.residuals, damping)
        return step, step

    def moved(self, point: _Estimate, step: Array) -> _Estimate:
        return self.estimate(rotation_from_vector(step[3:]) @ point.rotation, point.translation + step[:3])

    def objective(self, point: _Estimate) -> float:
        return float(point.residuals @ point.residuals)
