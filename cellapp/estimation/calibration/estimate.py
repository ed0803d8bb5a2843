"""Where an identification stands: values, normal equations, priors; and many effects whose part is factored once.

    [[G + P, C], [C^T, E]] x = b,   E = L L^T,   S = G - C E^-1 C^T

The priors P of the geometry are weighed anew at each step of the identification; those of effects, within E, are not.
So a step solves with S + P and the factor of E.
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
    """L (m, m), ``cross`` L^-1 C^T (m, size) and S (size, size), each parameter in its unit."""

    lower: Array
    cross: Array
    schur: Array

    @classmethod
    def of(cls, normal: NormalEquations, precision: Array, size: int) -> Eliminated | None:
        """From the precisions (k,) of all priors, of which the first ``size`` are of the geometry.

        None where the factors would be inaccurate.
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
        """Solution (k,) for precisions (size,) of the geometry's priors, in their units."""
        size = len(priors)
        behind = scipy.linalg.solve_triangular(self.lower, rhs[size:], lower=True, check_finite=False)
        first = solve_psd(self.schur + np.diag(priors), rhs[:size] - behind @ self.cross)
        rest = scipy.linalg.solve_triangular(
            self.lower, behind - self.cross @ first, lower=True, trans=1, check_finite=False
        )
        return np.concatenate([first, rest])

    def variances(self, priors: Array) -> Array:
        """Variances (size,) of the geometry."""
        return inverse_diagonal(self.schur + np.diag(priors))


@dataclass(frozen=True)
class Estimate:
    """Parameter values (k,), the normal equations there, the weights they were made with, precisions of priors (k,).

    ``variance`` multiplies the stated covariance of the readings where it is weighed against the priors. ``moved_m`` is
    how far the values are from those of the normal matrix [m at arm's length]. ``eliminated`` is that matrix where it
    is of many effects.
    """

    values: Array
    normal: NormalEquations
    weights: Array | None
    precision: Array
    variance: float = 1.0
    moved_m: float = 0.0
    eliminated: Eliminated | None = None

    def geometric_priors(self, size: int) -> Array:
        """Precisions of the geometry's priors (size,), in its units."""
        return np.asarray(self.precision[:size] * self.normal.unit[:size] ** 2)

    @property
    def by_priors(self) -> Array:
        """Share (k,) of each parameter that its prior, and not the readings, determines."""
        if not self.precision.any():
            return self.precision
        variances = inverse_diagonal(self.posterior_precision(self.variance))
        return np.asarray(self.precision * self.normal.unit**2 * variances)

    def covariance(self, variance: float) -> Array:
        """Covariance (k, k) of all values: the readings' part is scaled by their ``variance``, the priors are not."""
        unit = self.normal.unit
        return inverse_psd(self.posterior_precision(variance)) * (unit * unit[:, None])

    def posterior_precision(self, variance: float) -> Array:
        """Precision (k, k) of the parameters, each in its ``unit``."""
        H = self.normal.scaled_A / variance
        H.flat[:: len(H) + 1] += self.precision * self.normal.unit**2
        return H
