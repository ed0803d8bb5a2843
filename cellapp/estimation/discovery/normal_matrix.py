"""Normal equations of a linear model with priors: accumulated over readings, solved, and partly eliminated.

    (X^T X + P) b = X^T y

X are whitened columns, P prior precisions. Used by fits to all readings, the evidence of free functions and the folds
of the cross-validation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import cholesky, inverse_psd, solve_psd
from cellapp.robot.kinematics.transforms import Array

_SMALLEST = 1e-300
"""Guards divisions by a norm of zero."""


@dataclass(frozen=True, eq=False)
class NormalMatrix:
    """X^T X (p, p), X^T y (p,) and y^T y of whitened columns; y is the residual plus the present prediction."""

    gram: Array
    moment: Array
    square: float

    @classmethod
    def of(cls, rows: Array, target: Array) -> NormalMatrix:
        """Compute the products from columns as rows X^T (p, d) and y (d,)."""
        return cls(rows @ rows.T, rows @ target, float(target @ target))

    def __add__(self, other: NormalMatrix) -> NormalMatrix:
        """Add further readings."""
        return NormalMatrix(self.gram + other.gram, self.moment + other.moment, self.square + other.square)

    def __sub__(self, other: NormalMatrix) -> NormalMatrix:
        """Remove some of the readings."""
        return NormalMatrix(self.gram - other.gram, self.moment - other.moment, self.square - other.square)

    def take(self, places: NDArray[np.intp] | NDArray[np.bool_]) -> NormalMatrix:
        """Return the equations of some of the columns."""
        return NormalMatrix(self.gram[places][:, places], self.moment[places], self.square)

    def about(self, values: Array) -> NormalMatrix:
        """Add what ``values`` (p,) predict to the residual: priors about zero concern the sum of both."""
        of_values = self.gram @ values
        square = self.square + float(values @ (2.0 * self.moment + of_values))
        return NormalMatrix(self.gram, self.moment + of_values, square)

    def log_occam(self, variance: Array) -> float:
        """Return ``ln det(I + V^1/2 X^T X V^1/2)`` for prior variances V (p,): the Occam factor of the columns."""
        root = np.sqrt(variance)
        gram = self.gram * (root[:, None] * root)
        gram.flat[:: len(gram) + 1] += 1.0
        try:
            return 2.0 * float(np.sum(np.log(np.diag(np.linalg.cholesky(gram)))))
        except np.linalg.LinAlgError:  # without noise, rounding exceeds the share of the priors
            return float(np.sum(np.log(np.maximum(np.linalg.eigvalsh(gram), 1.0))))

    @property
    def scale(self) -> Array:
        """Scale (p,) of each parameter that gives its column unit norm."""
        return np.asarray(1.0 / np.sqrt(np.maximum(np.diag(self.gram), _SMALLEST)))

    def with_priors(self, precision: Array, scale: Array | None = None) -> Solver:
        """Return the equations with prior precisions (p,).

        For a subset of the readings pass the ``scale`` of all: what it does not determine is then zero up to rounding.
        """
        scale = self.scale if scale is None else scale
        return Solver(self, precision, scale)

    def determined(self, precision: Array) -> float:
        """Return the effective number of parameters that the readings determine beside prior precisions (p,)."""
        return len(precision) - float(np.sum(precision * np.diag(self.with_priors(precision).covariance)))

    def behind(self, flat: int, precision: Array) -> tuple[NormalMatrix, float]:
        """Eliminate the first ``flat`` columns, with prior precisions (flat,); return the equations of the others.

        The second value is the effective number of the eliminated parameters that the readings determine.
        """
        first = NormalMatrix(self.gram[:flat, :flat], self.moment[:flat], self.square).with_priors(precision)
        inverse = first.covariance
        cross, moment = self.gram[:flat, flat:], self.moment[:flat]
        explained = inverse @ cross
        behind = NormalMatrix(
            self.gram[flat:, flat:] - cross.T @ explained,
            self.moment[flat:] - explained.T @ moment,
            self.square - float(moment @ inverse @ moment),
        )
        return behind, flat - float(np.sum(precision * np.diag(inverse)))


@dataclass(frozen=True, eq=False)
class Solver:
    """Normal equations with prior precisions (p,); ``scale`` (p,) makes the parameters comparable."""

    normal: NormalMatrix
    precision: Array
    scale: Array

    @cached_property
    def covariance(self) -> Array:
        """Inverse of X^T X + P."""
        return inverse_psd(self._scaled()) * (self.scale[:, None] * self.scale)

    @cached_property
    def solution(self) -> Array:
        """Values (p,) of all parameters under the priors."""
        return self.solve(self.normal.moment)

    def solve(self, rhs: Array) -> Array:
        """``(X^T X + P)^-1 rhs`` for (p,) or (p, r)."""
        return self.factored.solve(rhs)

    def in_standard_errors(self, step: Array) -> Array:
        """Return a vector (p,) as long as a step (p,) in standard errors: its square is the change of the objective."""
        scaled, factored = step / self.scale, self.factored
        if factored.is_factor:
            return np.asarray(factored.matrix.T @ scaled)
        return np.sqrt(np.abs(scaled * (factored.matrix @ scaled)))

    @cached_property
    def factored(self) -> Factored:
        """What solves without X^T X."""
        scaled = self._scaled()
        factor = cholesky(scaled)
        return Factored(scaled if factor is None else factor, self.scale, is_factor=factor is not None)

    def _scaled(self) -> Array:
        """Return X^T X + P with each parameter in its scale; not cached, as it is large."""
        A = self.normal.gram * (self.scale[:, None] * self.scale)
        A.flat[:: len(A) + 1] += self.precision * self.scale**2
        return A


@dataclass(frozen=True, eq=False)
class Factored:
    """X^T X + P, each parameter in its ``scale`` (p,): its Cholesky factor (p, p), or itself if that is inaccurate."""

    matrix: Array
    scale: Array
    is_factor: bool

    def solve(self, rhs: Array) -> Array:
        """``(X^T X + P)^-1 rhs`` for (p,) or (p, r)."""
        scale = self.scale if rhs.ndim == 1 else self.scale[:, None]
        if not self.is_factor:
            return np.asarray(scale * solve_psd(self.matrix, scale * rhs))
        return np.asarray(scale * scipy.linalg.lapack.dpotrs(self.matrix, scale * rhs, lower=1)[0])
