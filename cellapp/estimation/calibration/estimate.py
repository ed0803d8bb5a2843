"""State of an identification: values, normal equations, priors. The block of many effects is factored only once.

    [[G + P, C], [C^T, E]] x = b,   E = L L^T,   S = G - C E^-1 C^T

The geometry's priors P are weighed anew at each step of the identification; those of effects, part of E, are not.
So a step solves with the Schur complement S + P and the factor of E.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from cellapp.estimation.calibration.linear import PIVOT, cholesky, inverse_diagonal, inverse_psd, solve_psd
from cellapp.estimation.calibration.normal_equations import NormalEquations
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Factors after elimination of the effects: L (m, m), ``cross`` L^-1 C^T (m, size), S (size, size), each parameter
    in its unit."""

    lower: Array
    cross: Array
    schur: Array

    @classmethod
    def of(cls, normal: NormalEquations, precision: Array, size: int) -> Eliminated | None:
        """Factor with the precisions (k,) of all priors, of which the first ``size`` are the geometry's.

        Return None if the factors would be inaccurate.
        """
        H, priors = normal.scaled_A, precision * normal.unit**2
        E = H[size:, size:].copy()
        E.flat[:: len(E) + 1] += priors[size:]
        lower = cholesky(E)
        if lower is None:
            return None
        cross = scipy.linalg.solve_triangular(lower, H[size:, :size], lower=True, check_finite=False)
        S = H[:size, :size] - cross.T @ cross
        whole = cholesky(S + np.diag(priors[:size]))
        if whole is None or not (whole.diagonal() > PIVOT * np.sqrt(H.diagonal()[:size] + priors[:size])).all():
            return None
        return cls(lower, cross, S)

    def solve(self, rhs: Array, priors: Array) -> Array:
        """Solve for x (k,) with precisions (size,) of the geometry's priors, in their units."""
        size = len(priors)
        behind = scipy.linalg.solve_triangular(self.lower, rhs[size:], lower=True, check_finite=False)
        first = solve_psd(self.schur + np.diag(priors), rhs[:size] - behind @ self.cross)
        rest = scipy.linalg.solve_triangular(
            self.lower, behind - self.cross @ first, lower=True, trans=1, check_finite=False
        )
        return np.concatenate([first, rest])

    def variances(self, priors: Array) -> Array:
        """Compute the variances (size,) of the geometry's parameters."""
        return inverse_diagonal(self.schur + np.diag(priors))


@dataclass(frozen=True)
class Estimate:
    """Parameter values (k,), the normal equations there, the weights used in them, precisions of priors (k,).

    ``variance`` scales the stated covariance of the readings when they are weighed against the priors. ``moved_m`` is
    the distance of the values from those of the normal matrix [m at arm's length]. ``eliminated`` is that matrix in
    factored form, for many effects; else None.
    """

    values: Array
    normal: NormalEquations
    weights: Array | None
    precision: Array
    variance: float = 1.0
    moved_m: float = 0.0
    eliminated: Eliminated | None = None

    def geometric_priors(self, size: int) -> Array:
        """Return the precisions (size,) of the geometry's priors, in its units."""
        return np.asarray(self.precision[:size] * self.normal.unit[:size] ** 2)

    @property
    def by_priors(self) -> Array:
        """Share (k,) of each parameter that its prior, and not the readings, determines."""
        if not self.precision.any():
            return self.precision
        variances = inverse_diagonal(self.posterior_precision(self.variance))
        return np.asarray(self.precision * self.normal.unit**2 * variances)

    def covariance(self, variance: float) -> Array:
        """Compute the covariance (k, k) of all values; ``variance`` scales the readings' part, not the priors."""
        unit = self.normal.unit
        return inverse_psd(self.posterior_precision(variance)) * (unit * unit[:, None])

    def posterior_precision(self, variance: float) -> Array:
        """Compute the posterior precision (k, k) of the parameters, each in its ``unit``."""
        H = self.normal.scaled_A / variance
        H.flat[:: len(H) + 1] += self.precision * self.normal.unit**2
        return H
