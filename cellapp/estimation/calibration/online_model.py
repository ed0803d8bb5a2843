"""Linear model of one arm's readings about one geometry, for ``online``: it is updated reading by reading."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import inverse_psd
from cellapp.estimation.calibration.weights import MEDIAN_NORM, excess_variance
from cellapp.robot.kinematics.transforms import Array

GROSS = 12.0
"""Residual beyond which a reading has no weight, in standard uncertainties: far above that of unmodelled physics."""
_ANCHOR = 4.0
"""Prior degrees of freedom that hold the scatter at the expected one while there are few readings."""
_LEAST_VARIANCE = 1e-14
"""Least variance, (0.1 um)^2, for points without stated noise that fit exactly: it keeps weights finite."""


@dataclass
class LinearModel:
    """Normal equations of the readings about one geometry, and their solution with priors.

    ``solve`` solves them; ``add`` then updates the solution reading by reading, not the normal equations.

    Attributes
    ----------
    A, b, cost : array (k, k), array (k,), float
        ``sum J^T W J``, ``sum J^T W r``, ``sum r^T W r``.
    scale : array, shape (k,)
        Converts parameters to metres at arm's length.
    precision : array, shape (k,)
        Precision of each prior, zero without one.
    prior_step : array, shape (k,)
        Difference from the present geometry to the mean of the priors.
    used : int
        Number of readings with nonzero weight.
    excess, mean_stated : float
        Excess variance of a coordinate, and mean of the stated variances [m^2].
    variance : float
        Chi-square per degree of freedom.
    freedom : float
        Degrees of freedom: coordinates less the parameters that they determine.
    step, covariance : array (k,), array (k, k)
        Difference from the geometry to the estimate, and covariance of the estimate.
    """

    A: Array
    b: Array
    cost: float
    scale: Array
    precision: Array
    prior_step: Array
    used: int
    excess: float
    mean_stated: float
    variance: float = 1.0
    freedom: float = 1.0
    step: Array = field(default_factory=lambda: np.zeros(0))
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    _weight: float = 1.0
    """Value of ``variance`` with which the readings were weighed against the priors."""
    _chi_square: float = 0.0

    @property
    def moved(self) -> float:
        """Largest component of ``step`` [m at arm's length]."""
        return float(np.max(np.abs(self.step * self.scale)))

    @property
    def scatter_m(self) -> float:
        """Standard deviation of a measured coordinate about the model [m]."""
        return math.sqrt(self.variance * (self.excess + self.mean_stated))

    def solve(self) -> None:
        """Compute estimate and covariance with the present scatter, then the scatter of the new residuals."""
        unit = 1.0 / self.scale
        H = self.A / self.variance
        H.flat[:: len(H) + 1] += self.precision
        self.covariance = inverse_psd(H * unit * unit[:, None]) * unit * unit[:, None]
        self.step = self.covariance @ (self.b / self.variance + self.precision * self.prior_step)
        self._weight = self.variance
        by_priors = float(self.precision @ np.diag(self.covariance))  # number of parameters that the priors determine
        self.freedom = max(1.0, 3.0 * self.used - len(self.precision) + by_priors)
        self._chi_square = max(self.cost - float(self.step @ (2.0 * self.b - self.A @ self.step)), 0.0)
        self._find_variance()

    def loss(self, square: float, step: Array) -> float:
        """Compute what the solution minimises, at a ``step`` (k,) after which ``square`` is ``sum r^T W r``."""
        return square / self._weight + float(self.precision @ (step - self.prior_step) ** 2)

    def innovation(self, J: Array, off: Array, stated: Array) -> tuple[Array, Array]:
        """Compute measured less predicted position (3,) [m] of a reading not yet added, and its covariance (3, 3).

        ``J`` (3, k) is its Jacobian, ``off`` (3,) [m] its position less that of the geometry, ``stated`` (3, 3) [m^2]
        its stated covariance.
        """
        return off - J @ self.step, J @ self.covariance @ J.T + self._weight * (stated + self.excess * np.eye(3))

    def add(self, J: Array, off: Array, stated: Array) -> None:
        """Update estimate and covariance with a reading: a step of recursive least squares."""
        innovation, expected = self.innovation(J, off, stated)
        seen = J @ self.covariance
        solved = np.linalg.solve(expected, np.column_stack([seen, innovation]))
        self.step = self.step + seen.T @ solved[:, -1]
        self.covariance = self.covariance - seen.T @ solved[:, :-1]
        self._chi_square += self._weight * float(innovation @ solved[:, -1])
        self.freedom += 3.0
        self._find_variance()

    def _find_variance(self) -> None:
        self.variance = (self._chi_square + _ANCHOR) / (self.freedom + _ANCHOR)


class StoredReadings:
    """All readings of an arm, in arrays that grow by doubling."""

    def __init__(self, joints: int) -> None:
        self.count = 0
        self._q, self._p_M, self._stated = np.empty((64, joints)), np.empty((64, 3)), np.empty((64, 3, 3))

    @property
    def q(self) -> Array:
        """Joint positions (n, N) [rad]."""
        return self._q[: self.count]

    @property
    def p_M(self) -> Array:
        """Measured points (n, 3) [m]."""
        return self._p_M[: self.count]

    def append(self, q: Array, p_M: Array, covariance_M: Array | None) -> None:
        """Store one reading."""
        if self.count == len(self._q):
            self._q, self._p_M, self._stated = (
                np.concatenate([old, np.empty_like(old)]) for old in (self._q, self._p_M, self._stated)
            )
        self._q[self.count], self._p_M[self.count] = q, p_M
        self._stated[self.count] = math.nan if covariance_M is None else covariance_M
        self.count += 1

    def stated(self) -> Array:
        """Return stated covariances (n, 3, 3) [m^2]; a missing one is the mean of the others, zero without any."""
        stated = self._stated[: self.count]
        missing = np.isnan(stated).any(axis=(1, 2))
        if not missing.any():
            return stated
        filled = stated.copy()
        filled[missing] = 0.0 if missing.all() else stated[~missing].mean(axis=0)
        return filled

    def newest_stated(self) -> Array:
        """Return the stated covariance (3, 3) [m^2] of the newest reading, filled in likewise."""
        newest = self._stated[self.count - 1]
        return np.asarray(self.stated()[-1] if np.isnan(newest).any() else newest)


def gross_weights(residuals: Array, stated: Array, excess: float) -> Array:
    """Return weights (n,): 0 for readings whose residual (n, 3) [m] is far above that of most others, else 1."""
    variance = excess + np.trace(stated, axis1=1, axis2=2) / 3.0
    norm = np.sqrt(np.sum(residuals**2, axis=1) / variance)
    return np.where(norm > GROSS * max(float(np.median(norm)) / MEDIAN_NORM, 1.0), 0.0, 1.0)


@dataclass(frozen=True)
class Residuals:
    """Residuals of one arm's readings by a model.

    Attributes
    ----------
    length_m : array, shape (n,)
        Distance of each point from the model's [m].
    sigma_m : array, shape (n,)
        Rms of this distance from stated noise and scatter [m]: the root of the trace of the covariance.
    gross : array, shape (n,)
        Mask of gross errors, which have no weight.
    """

    length_m: Array
    sigma_m: Array
    gross: NDArray[np.bool_]

    @classmethod
    def of(cls, left_M: Array, stated: Array, model: LinearModel) -> Residuals:
        """Compute from residuals (n, 3) [m] and stated covariances (n, 3, 3) [m^2]."""
        variance = model.variance * (np.trace(stated, axis1=1, axis2=2) + 3.0 * model.excess)
        return cls(
            np.linalg.norm(left_M, axis=1), np.sqrt(variance), gross_weights(left_M, stated, model.excess) == 0.0
        )


def excess_of(residuals: Array, stated: Array, weights: Array, freedom: float) -> float:
    """Estimate the excess variance of a coordinate [m^2] from readings with nonzero weight; it is the whole variance if
    no covariance is stated."""
    used = weights > 0.0
    if not stated.any():
        return max(float(np.sum(residuals[used] ** 2)) / freedom, _LEAST_VARIANCE)
    return excess_variance(residuals[used], stated[used], round(freedom))
