"""Solve with symmetric positive semi-definite matrices: by Cholesky if that is accurate, else by truncated eigenvalues.

Least squares with columns ``X`` (d, p) and prior precisions ``P`` needs ``G = X^T X + P``. Redundant parameters make G
singular. All modules use this rule:

1. Factor ``G = L L^T``. ``L_ii^2 / G_ii`` is the share of column i that columns 1 to i - 1 do not explain (the
   *tolerance* of regression, the inverse of the variance inflation factor). It does not depend on the columns' units.
   If every ``L_ii > PIVOT sqrt(G_ii)``, use the factor.
2. Else decompose ``G = V diag(e) V^T`` and drop eigenvalues below ``EIGENVALUE`` times the largest. This gives the
   solution of least norm in the caller's scaling: scale parameters to comparable size before (unit columns, or metres
   at arm's length).

Sources: Golub, Van Loan, Matrix Computations, 4th ed., sections 4.2 and 5.5; van der Sluis, Numer. Math. 14 (1969) 14
(Cholesky's accuracy does not depend on the scaling of the columns).
"""

from __future__ import annotations

import numpy as np
import scipy

from cellapp.robot.kinematics.transforms import Array

PIVOT = 3e-5
"""Least L_ii / sqrt(G_ii) for which the Cholesky factor is used. The relative error of a solution is about
eps / PIVOT^2 = 2e-7, a tenth of a nanometre on a correction of a millimetre."""
EIGENVALUE = 1e-11
"""Share of the largest eigenvalue below which one counts as zero: 1e5 eps, above rounding; about PIVOT^2 / 100, so that
a matrix just below the limit for Cholesky loses no direction."""
_SMALLEST = 1e-300
"""Lower bound of a norm that is divided by: far below any data and above the smallest float."""


def cholesky(gram: Array) -> Array | None:
    """Compute the lower Cholesky factor of ``gram`` (p, p), zero above the diagonal; None if it would be inaccurate."""
    factor, failed = scipy.linalg.lapack.dpotrf(gram, lower=1)
    if failed or not (factor.diagonal() > PIVOT * np.sqrt(gram.diagonal())).all():
        return None
    return np.asarray(factor)


def solve_psd(gram: Array, rhs: Array) -> Array:
    """``gram^-1 rhs`` for ``rhs`` (p,) or (p, r); the solution of least norm where ``gram`` (p, p) is singular."""
    if not rhs.size:  # LAPACK refuses it
        return np.zeros(rhs.shape)
    factor = cholesky(gram)
    if factor is not None:
        return np.asarray(scipy.linalg.lapack.dpotrs(factor, rhs, lower=1)[0])
    values, vectors = _significant(gram)
    return np.asarray((vectors / values) @ (vectors.T @ rhs))


def inverse_psd(gram: Array) -> Array:
    """Compute the inverse of ``gram`` (p, p); the pseudo-inverse if it is singular."""
    factor = cholesky(gram)
    if factor is not None:
        lower = scipy.linalg.lapack.dpotri(factor, lower=1)[0]  # leaves the zeros above the diagonal
        inverse = lower + lower.T
        np.fill_diagonal(inverse, lower.diagonal())
        return np.asarray(inverse)
    values, vectors = _significant(gram)
    return np.asarray((vectors / values) @ vectors.T)


def covariance_with_priors(information: Array, sds: Array) -> Array:
    """Compute the covariance (p, p) from ``information`` (p, p) and standard deviations (p,) of priors, inf without."""
    unit = np.where(np.isfinite(sds), sds, 1.0)  # scales the entries to comparable size
    precision = (information + np.diag(sds**-2.0)) * unit * unit[:, None]
    return inverse_psd(precision) * unit * unit[:, None]


def inverse_diagonal(gram: Array) -> Array:
    """Compute the diagonal (p,) of the inverse of ``gram`` (p, p)."""
    factor = cholesky(gram)
    inverse = inverse_psd(gram) if factor is None else scipy.linalg.lapack.dpotri(factor, lower=1)[0]
    return np.asarray(inverse.diagonal())


def orthonormal_basis(rows: Array, precision: Array | None = None, gram: Array | None = None) -> Array:
    """Compute ``Q`` (d, k) with ``Q Q^T = X (X^T X + P)^-1 X^T``; its columns are orthonormal without priors.

    Parameters
    ----------
    rows : array, shape (p, d)
        Columns X as rows.
    precision : array, shape (p,), optional
        Diagonal of P: inverse prior variances, zero without a prior.
    gram : array, shape (p, p), optional
        X^T X, if known.
    """
    gram = rows @ rows.T if gram is None else gram
    scale = 1.0 / np.maximum(np.sqrt(gram.diagonal()), _SMALLEST)
    gram = gram * (scale[:, None] * scale)
    if precision is not None:
        gram.flat[:: len(gram) + 1] += precision * scale**2
    factor, scaled = cholesky(gram), (rows * scale[:, None]).T
    if factor is not None:  # X is in the memory order of LAPACK: no copy
        solve = scipy.linalg.blas.dtrsm
        return np.asarray(solve(1.0, factor, scaled, side=1, lower=1, trans_a=1, overwrite_b=1))
    values, vectors = _significant(gram)
    return np.asarray(scaled @ (vectors / np.sqrt(values)))


def _significant(gram: Array) -> tuple[Array, Array]:
    """Compute the eigenvalues (k,) that do not count as zero, and their vectors (p, k)."""
    values, vectors = np.linalg.eigh(gram)
    kept = values > EIGENVALUE * values[-1]
    return values[kept], vectors[:, kept]
