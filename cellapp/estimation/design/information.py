"""Information about effects with nuisance parameters eliminated: projection, visible share, smallest detectable size.

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

from cellapp.estimation.calibration.least_squares import orthonormal_basis
from cellapp.robot.kinematics.transforms import Array

VISIBLE = 1e-3
"""Least share (in norm) of a visible direction outside the span of the nuisance parameters. If geometry errors of 0.1
mm to 1 mm explain the rest, the visible part is below 1 um: a laser tracker does not resolve it."""
SMALLEST = 1e-300
"""Guard against division by a zero norm; far below any datum, above the smallest float."""


@dataclass(frozen=True, eq=False)
class NuisanceProjector:
    """M = I - Q Q^T of a model's nuisance parameters, with ``basis`` Q (d, k)."""

    basis: Array

    @classmethod
    def of(cls, rows: Array, precision: Array | None = None, gram: Array | None = None) -> NuisanceProjector:
        """Build from the whitened columns X^T as rows (p, d) and their prior precisions (p,), zero if None.

        ``gram`` (p, p) is X^T X, None if it is not yet known.
        """
        return cls(orthonormal_basis(rows, precision, gram))

    @property
    def effective_parameters(self) -> float:
        """Number of parameters that the data determine: trace of X (X^T X + P)^-1 X^T."""
        return float(np.sum(self.basis**2))

    @cached_property
    def freedom(self) -> float:
        """Number of coordinates less the parameters that the data determine; at least 1."""
        return max(len(self.basis) - self.effective_parameters, 1.0)

    def project(self, rows: Array) -> Array:
        """Return ``rows`` (..., d) times M."""
        coordinates, size = self.basis.shape
        if 2 * size > coordinates and rows.size > coordinates * size:  # M itself has fewer numbers than Q and Q^T
            return np.asarray(rows @ self._matrix)
        explained = (rows @ self.basis) @ self.basis.T
        return np.subtract(rows, explained, out=explained)  # no third array: a scan's columns are tens of megabytes

    @cached_property
    def _matrix(self) -> Array:
        """M (d, d)."""
        return np.asarray(np.eye(len(self.basis)) - self.basis @ self.basis.T)

    def kernel(self, first: Array, second: Array | None = None) -> Array:
        """Return K (n, n) with ``(f u) M (g v)^T = f K g^T`` for functions f, g and motions u, v (a, n) of n points.

        ``second`` is v, u itself if None. Many functions share one motion, so K saves their projections.
        """
        second = first if second is None else second
        n = first.shape[1]
        of_second = np.einsum("ibj,bj->ij", self._matrix.reshape(-1, len(second), n), second)
        return np.asarray(np.einsum("aij,ai->ij", of_second.reshape(len(first), n, n), first))

    def behind(self, rows: Array) -> Behind:
        """Return rows (m, d) in the complement of the parameters."""
        return Behind(rows, rows @ self.basis)


@dataclass(frozen=True, eq=False)
class Behind:
    """Rows B (m, d) in the complement of a model's parameters, by ``explained`` B Q (m, k); M B^T is not stored."""

    rows: Array
    explained: Array

    def take(self, places: slice | NDArray[np.intp]) -> Behind:
        """Return some of the rows."""
        return Behind(self.rows[places], self.explained[places])

    def gram(self, other: Behind | None = None) -> Array:
        """Return B M C^T of these rows (..., m, d) and other ones, by default these themselves."""
        other = other or self
        products = self.rows @ other.rows.swapaxes(-1, -2)
        products -= self.explained @ other.explained.swapaxes(-1, -2)
        return np.asarray(products)

    @cached_property
    def squares(self) -> Array:
        """b^T M b (m,) of each row: with priors M is no projection, and |M b|^2 would be too small."""
        squares = np.einsum("md,md->m", self.rows, self.rows) - np.einsum("mk,mk->m", self.explained, self.explained)
        return np.asarray(np.maximum(squares, 0.0))


def visible_root(gram: Array, norms: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return R with R^T gram R = I on the visible directions and zero on the others, and the number of visible ones.

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


def visible_squares(gram: Array, norms: Array, moments: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return m^T G^-1 m (...,) of ``moments`` m (..., k) over the visible directions, and the number of these.

    The result is that of ``visible_root``, but up to five times as fast if a Cholesky factor of G less the limit shows
    that all directions are visible.
    """
    scale = 1.0 / np.maximum(norms, SMALLEST)
    scaled, along = gram * scale[..., :, None] * scale[..., None, :], moments * scale
    size = gram.shape[-1]
    try:
        np.linalg.cholesky(scaled - VISIBLE**2 * np.eye(size))
    except np.linalg.LinAlgError:
        root, count = visible_root(gram, norms)
        return np.asarray(np.sum(np.einsum("...kr,...k->...r", root, moments) ** 2, axis=-1)), count
    solved = np.linalg.solve(scaled, along[..., None])[..., 0]
    return np.einsum("...k,...k->...", along, solved), np.full(gram.shape[:-2], size, dtype=np.intp)


def detectable_size(visible_norm: float, needed: float) -> float:
    """Return the size of a parameter at which its non-centrality (size^2 b^T M b) reaches ``needed``."""
    return math.sqrt(needed) / visible_norm
