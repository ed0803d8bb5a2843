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
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import orthonormal_basis
from cellapp.estimation.design.block_design import trace_of_solution
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


# Choice of stops that discriminate between two models: T-optimality (Atkinson, Fedorov, Biometrika 62 (1975) 57, 289).
#
# The true model predicts the whitened signal ``a`` of an effect at every stop. The alternative model (geometry, other
# accepted effects, another effect in its place) with columns X and prior precisions P is fitted to that signal. The
# minimum
#
#     lambda = min over eta of  |a - X^T eta|^2 + eta^T P eta,
#
# is the non-centrality of the test between the two. A further stop with columns x (p, 3) and signal a_x adds exactly
#
#     (a_x - x^T eta)^T (I + x^T G^-1 x)^-1 (a_x - x^T eta),    G = X X^T + P.
#
# All candidates are evaluated together; adding one updates G^-1 by a matrix of rank three (Woodbury).

_RIDGE = 1e-11
"""Added to the diagonal of the scaled normal matrix (unit columns): directions that the run does not determine stay
nearly free, and the inverse is accurate to five digits."""
HOPELESS = 0.02
"""Share of the needed lambda: a comparison to which all remaining stops together would add less is ignored, as stops
for it would be wasted."""
_MAXIMIN_POWER = 3.0
"""Exponent of the weight (lambda / least lambda)^-power of each comparison: at 3, twice the lambda (relative to its
need) has an eighth of the weight. The worst one dominates, as in a maximin design; the others break ties."""
_LAMBDA_OFFSET = 1e-3
"""Added to lambda over its need before that ratio, as lambda is zero while nothing discriminates."""


def unit_columns(run: Array, precision: Array, candidates: Array) -> tuple[Array, Array, Array]:
    """Scale columns on run (p, d) and candidates (p, m, 3) to unit size, and precisions (p,), which get the ridge."""
    squares = np.einsum("pd,pd->p", run, run)
    squares = squares + np.einsum("pmc,pmc->p", candidates, candidates) / max(candidates.shape[1], 1)
    scale = 1.0 / np.sqrt(np.maximum(squares, 1e-300))
    return run * scale[:, None], precision * scale**2 + _RIDGE, candidates * scale[:, None, None]


@dataclass(frozen=True, eq=False)
class TwoModels:
    """Signals of one model against an alternative model, on the run and at candidate stops. All arrays are whitened.

    Attributes
    ----------
    run_columns : array, shape (p, d)
        Columns of the alternative model on the run, scaled to unit size.
    prior : array, shape (p,)
        Their prior precisions, with the ridge.
    candidate_columns : array, shape (p, m, 3)
        Columns of the alternative model at the candidates, scaled alike.
    run_signals : array, shape (k, d)
        Signals on the run; lambda is their mean.
    candidate_signals : array, shape (k, m, 3)
        Signals at the candidates.
    """

    run_columns: Array
    prior: Array
    candidate_columns: Array
    run_signals: Array
    candidate_signals: Array

    @cached_property
    def _gram(self) -> Array:
        """Normal matrix G (p, p) of the run."""
        return np.asarray(self.run_columns @ self.run_columns.T + np.diag(self.prior))

    def noncentrality(self, chosen: NDArray[np.intp]) -> float:
        """Return lambda of the run together with the candidates ``chosen``."""
        columns = self.candidate_columns[:, chosen].reshape(len(self.run_columns), -1)
        signals = self.candidate_signals[:, chosen].reshape(len(self.run_signals), -1)
        moment = self.run_columns @ self.run_signals.T + columns @ signals.T
        eta = scipy.linalg.cho_solve(scipy.linalg.cho_factor(self._gram + columns @ columns.T, lower=True), moment)
        return self._square(eta, float(np.sum((signals - eta.T @ columns) ** 2))) / len(self.run_signals)

    def _square(self, eta: Array, of_stops: float = 0.0) -> float:
        """Return |a - X^T eta|^2 + eta^T P eta for ``eta`` (p, k): of the run, and the first term ``of_stops``."""
        # from the residual: the difference of two large sums of squares would lose precision
        square = float(np.sum((self.run_signals - eta.T @ self.run_columns) ** 2))
        return square + of_stops + float(np.einsum("pk,p,pk->", eta, self.prior, eta))

    def start_design(self) -> SequentialDesign:
        """Return the state before the first further stop."""
        inverse = scipy.linalg.cho_solve(scipy.linalg.cho_factor(self._gram, lower=True), np.eye(len(self._gram)))
        eta = inverse @ (self.run_columns @ self.run_signals.T)
        by_stop = np.ascontiguousarray(self.candidate_columns.transpose(1, 2, 0))
        return SequentialDesign(
            columns=by_stop,
            inverse=inverse,
            variance=np.einsum("mcp,mep->mce", by_stop @ inverse, by_stop, optimize=True),
            error=self.candidate_signals - np.einsum("mcp,pk->kmc", by_stop, eta),
            noncentrality=self._square(eta) / len(self.run_signals),
        )


@dataclass(eq=False)
class SequentialDesign:
    """State of a discrimination while stops are added one by one.

    Attributes
    ----------
    columns : array, shape (m, 3, p)
        Scaled columns of each candidate.
    inverse : array, shape (p, p)
        Inverse of the normal matrix G.
    variance : array, shape (m, 3, 3)
        x^T G^-1 x: variance of the alternative's prediction at each candidate.
    error : array, shape (k, m, 3)
        Signal minus the alternative's prediction at each candidate.
    noncentrality : float
        Lambda with the stops added so far.
    """

    columns: Array
    inverse: Array
    variance: Array
    error: Array
    noncentrality: float

    def gains(self) -> Array:
        """Return the increase of lambda by each candidate, (m,)."""
        squares = np.einsum("kme,kmf->mef", self.error, self.error) / len(self.error)
        return trace_of_solution(self.variance, squares, 1.0)

    def add(self, candidate: int) -> None:
        """Add a candidate to the design."""
        weight = np.linalg.inv(np.eye(3) + self.variance[candidate])
        error = self.error[:, candidate].copy()
        gain = self.inverse @ self.columns[candidate].T
        cross = self.columns @ gain
        self.noncentrality += float(np.einsum("kc,ce,ke->", error, weight, error)) / len(self.error)
        self.error -= np.einsum("mce,kf,fe->kmc", cross, error, weight, optimize=True)
        self.variance -= cross @ weight @ cross.transpose(0, 2, 1)
        self.inverse -= gain @ weight @ gain.T


def joint_gains(designs: Sequence[SequentialDesign], needed: Sequence[float], stops: int) -> Array:
    """Return the gain of each candidate (m,) over several comparisons, nearly maximin, scaled to a largest value of 1.

    Parameters
    ----------
    designs : sequence of SequentialDesign
        One for each comparison; at least one.
    needed : sequence of float
        Lambda that each needs.
    stops : int
        Stops still to be chosen: comparisons that these cannot decide are ignored.
    """
    gains = [design.gains() / need for design, need in zip(designs, needed, strict=True)]
    reached = [design.noncentrality / need for design, need in zip(designs, needed, strict=True)]
    hopeful = [k for k, gain in enumerate(gains) if stops * float(gain.max()) > HOPELESS * max(1.0, reached[k])]
    if hopeful:
        least = min(reached[k] for k in hopeful) + _LAMBDA_OFFSET
        total = sum(
            (gains[k] * ((reached[k] + _LAMBDA_OFFSET) / least) ** -_MAXIMIN_POWER for k in hopeful),
            np.zeros_like(gains[0]),
        )
    else:
        total = np.sum(gains, axis=0)
    largest = float(total.max(initial=0.0))
    return np.asarray(total / largest if largest > 0.0 else total)
