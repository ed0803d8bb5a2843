"""Choice of stops that discriminate between two models: T-optimality (Atkinson, Fedorov, Biometrika 62 (1975) 57, 289).

The true model predicts the whitened signal ``a`` of an effect at every stop. The rival model (geometry, other accepted
effects, another effect in its place) with columns X and prior precisions P is fitted to that signal. The minimum

    lambda = min over eta of  |a - X^T eta|^2 + eta^T P eta,

is the non-centrality of the test between the two. A further stop with columns x (p, 3) and signal a_x adds exactly

    (a_x - x^T eta)^T (I + x^T G^-1 x)^-1 (a_x - x^T eta),    G = X X^T + P.

All candidates are evaluated together; adding one updates G^-1 by a matrix of rank three (Woodbury).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.design.block_design import COLUMN, ROW, trace_of_solution
from cellapp.robot.kinematics.transforms import Array

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


@dataclass(frozen=True, eq=False)
class _Scaled:
    """The rival's columns scaled to unit size, on run (p, d) and candidates (p, m, 3); normal matrix, precisions."""

    run: Array
    candidates: Array
    gram: Array
    prior: Array


@dataclass(frozen=True, eq=False)
class Discrimination:
    """Signals of one model against a rival model, on the run and at candidate stops. All arrays are whitened.

    Attributes
    ----------
    run_columns : array, shape (p, d)
        Columns of the rival model on the run.
    precision : array, shape (p,)
        Their prior precisions.
    run_signals : array, shape (k, d)
        Signals on the run; lambda is their mean.
    candidate_columns : array, shape (p, m, 3)
        Columns of the rival model at the candidates.
    candidate_signals : array, shape (k, m, 3)
        Signals at the candidates.
    """

    run_columns: Array
    precision: Array
    run_signals: Array
    candidate_columns: Array
    candidate_signals: Array

    def _scaled(self) -> _Scaled:
        squares = np.einsum("pd,pd->p", self.run_columns, self.run_columns)
        candidates = self.candidate_columns
        squares = squares + np.einsum("pmc,pmc->p", candidates, candidates) / max(candidates.shape[1], 1)
        scale = 1.0 / np.sqrt(np.maximum(squares, 1e-300))
        run, prior = self.run_columns * scale[:, None], self.precision * scale**2 + _RIDGE
        return _Scaled(run, candidates * scale[:, None, None], run @ run.T + np.diag(prior), prior)

    def noncentrality(self, chosen: NDArray[np.intp]) -> float:
        """Return lambda of the run together with the candidates ``chosen``."""
        scaled = self._scaled()
        columns = scaled.candidates[:, chosen].reshape(len(scaled.run), -1)
        signals = self.candidate_signals[:, chosen].reshape(len(self.run_signals), -1)
        moment = scaled.run @ self.run_signals.T + columns @ signals.T
        eta = scipy.linalg.cho_solve(scipy.linalg.cho_factor(scaled.gram + columns @ columns.T, lower=True), moment)
        # from the residual: the difference of two large sums of squares would lose precision
        left = float(np.sum((self.run_signals - eta.T @ scaled.run) ** 2) + np.sum((signals - eta.T @ columns) ** 2))
        return (left + float(np.einsum("pk,p,pk->", eta, scaled.prior, eta))) / len(self.run_signals)

    def start_design(self) -> SequentialDesign:
        """Return the state before the first further stop."""
        scaled = self._scaled()
        inverse = scipy.linalg.cho_solve(scipy.linalg.cho_factor(scaled.gram, lower=True), np.eye(len(scaled.gram)))
        eta = inverse @ (scaled.run @ self.run_signals.T)
        left = float(np.sum((self.run_signals - eta.T @ scaled.run) ** 2))
        left += float(np.einsum("pk,p,pk->", eta, scaled.prior, eta))
        by_stop = np.ascontiguousarray(scaled.candidates.transpose(1, 2, 0))
        return SequentialDesign(
            columns=by_stop,
            inverse=inverse,
            variance=np.einsum("mcp,mep->mce", by_stop @ inverse, by_stop, optimize=True),
            error=self.candidate_signals - np.einsum("mcp,pk->kmc", by_stop, eta),
            noncentrality=left / len(self.run_signals),
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
        x^T G^-1 x: variance of the rival's prediction at each candidate.
    error : array, shape (k, m, 3)
        Signal minus the rival's prediction at each candidate.
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
        squares = np.einsum("kme,kme->em", self.error[:, :, ROW], self.error[:, :, COLUMN]) / len(self.error)
        return trace_of_solution(self.variance[:, ROW, COLUMN].T, squares, 1.0)

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


def joint_gains(designs: Sequence[SequentialDesign], needed: Sequence[float], stops_left: int) -> Array:
    """Return the gain of each candidate (m,) over several comparisons, nearly maximin, scaled to a largest value of 1.

    Parameters
    ----------
    designs : sequence of SequentialDesign
        One for each comparison; at least one.
    needed : sequence of float
        Lambda that each needs.
    stops_left : int
        Stops still to be chosen: comparisons that these cannot decide are ignored.
    """
    gains = [design.gains() / need for design, need in zip(designs, needed, strict=True)]
    reached = [design.noncentrality / need for design, need in zip(designs, needed, strict=True)]
    hopeful = [k for k, gain in enumerate(gains) if stops_left * float(gain.max()) > HOPELESS * max(1.0, reached[k])]
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
