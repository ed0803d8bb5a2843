"""Information about effects beside nuisance parameters: projection, visible share, smallest detectable size.

Let X (d, p) be the whitened columns of the nuisance parameters (geometry, effects in the model), P their prior
precisions, and B (m, d) the whitened rows of an effect. Eliminating the nuisance parameters leaves

    M = I - X (X^T X + P)^-1 X^T = I - Q Q^T,      information about the effect = B M B^T

(the Schur complement of the information matrix: Pukelsheim, Optimal Design of Experiments, 2006, section 3.12).
Without priors M projects onto the orthogonal complement of X, and regression there equals the joint regression
(Frisch, Waugh 1933; Lovell 1963).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.linear import orthonormal_basis
from cellapp.robot.kinematics.transforms import Array

VISIBLE = 1e-3
"""Least share (in norm) of a direction that the nuisance parameters must leave for it to count as visible. If geometry
errors of 0.1 mm to 1 mm explain the rest, the visible part is below 1 um: a laser tracker does not resolve it."""
SMALLEST = 1e-300
"""Guards divisions by a norm of zero; far below any datum, above the smallest float."""


@dataclass(frozen=True, eq=False)
class NuisanceProjector:
    """M = I - Q Q^T of a model's nuisance parameters, with ``basis`` Q (d, k)."""

    basis: Array

    @classmethod
    def of(cls, rows: Array, precision: Array | None = None, gram: Array | None = None) -> NuisanceProjector:
        """From the whitened columns X^T as rows (p, d) and their prior precisions (p,), zero where not given.

        ``gram`` (p, p) is X^T X, where it is known.
        """
        return cls(orthonormal_basis(np.ascontiguousarray(rows.T), precision, gram))

    @property
    def effective_parameters(self) -> float:
        """Number of parameters that the data determine: trace of X (X^T X + P)^-1 X^T."""
        return float(np.sum(self.basis**2))

    def project(self, rows: Array) -> Array:
        """``rows`` (..., d) times M."""
        coordinates, size = self.basis.shape
        if 2 * size > coordinates and rows.size > coordinates * size:  # M itself has fewer numbers than Q and Q^T
            return np.asarray(rows @ self._matrix)
        explained = (rows @ self.basis) @ self.basis.T
        return np.subtract(rows, explained, out=explained)  # no third array: a scan's columns are tens of megabytes

    @cached_property
    def _matrix(self) -> Array:
        """M (d, d)."""
        return np.asarray(np.eye(len(self.basis)) - self.basis @ self.basis.T)


def visible_norms(rows: Array, projected: Array) -> Array:
    """Roots (m,) of b^T M b for rows b and their projections M b, both (m, d).

    With priors M is no projection, and |M b| would be too small.
    """
    return np.asarray(np.sqrt(np.maximum(np.einsum("md,md->m", rows, projected), 0.0)))


def visible_root(gram: Array, norms: Array) -> tuple[Array, NDArray[np.intp]]:
    """Root R with R^T gram R = I on the visible directions and zero on the others, and the number of visible ones.

    Parameters
    ----------
    gram : array, shape (..., k, k)
        Information B M B^T of k columns.
    norms : array, shape (..., k)
        Norms of the columns before projection.

    Returns
    -------
    root : array, shape (..., k, k)
    count : array, shape (...)
    """
    scale = 1.0 / np.maximum(norms, SMALLEST)
    values, vectors = np.linalg.eigh(gram * scale[..., :, None] * scale[..., None, :])
    visible = values > VISIBLE**2
    inverse = visible / np.sqrt(np.maximum(values, VISIBLE**2))
    return scale[..., :, None] * vectors * inverse[..., None, :], np.asarray(visible.sum(axis=-1))


def detectable_size(visible_norm: float, needed: float) -> float:
    """Size of a parameter at which its non-centrality (size^2 b^T M b) reaches ``needed``."""
    return math.sqrt(needed) / visible_norm
