"""Which further stops tell two models apart: T-optimality (Atkinson, Fedorov, Biometrika 62 (1975) 57 and 289).

One model says what an effect does at every stop: its signal ``a``, whitened. Its rival (geometry, the other accepted
effects, another effect in its place) is fitted to that signal; what it cannot follow,

    lambda = min over eta of  |a - X^T eta|^2 + eta^T P eta,

is the non-centrality of the test between them. A further stop with columns x (p, 3) and signal a_x adds exactly

    (a_x - x^T eta)^T (I + x^T G^-1 x)^-1 (a_x - x^T eta),    G = X X^T + P,

so that all candidates are judged at once, and the stop that is taken is a step of rank three.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from cellapp.kinematics.transforms import Array

_RIDGE = 1e-11
"""Of the scaled normal matrix: a direction that the run does not determine is nearly free, but has an inverse."""


@dataclass(frozen=True, eq=False)
class Contest:
    """Signals against a rival model, on the run and at candidate stops.

    Attributes
    ----------
    rows : array, shape (p, d)
        Whitened columns of the rival model on the run.
    precision : array, shape (p,)
        Of its priors.
    signals : array, shape (k, d)
        Whitened signals on the run; lambda is their mean.
    stops : array, shape (p, m, 3)
        Columns at the candidates.
    there : array, shape (k, m, 3)
        Signals at the candidates.
    """

    rows: Array
    precision: Array
    signals: Array
    stops: Array
    there: Array

    def scaled(self) -> tuple[Array, Array, Array, Array]:
        """Columns of one size on run and candidates, the normal matrix of the run with its priors, and the latter."""
        squares = np.einsum("pd,pd->p", self.rows, self.rows)
        squares = squares + np.einsum("pmc,pmc->p", self.stops, self.stops) / max(self.stops.shape[1], 1)
        scale = 1.0 / np.sqrt(np.maximum(squares, 1e-300))
        rows, stops = self.rows * scale[:, None], self.stops * scale[:, None, None]
        prior = self.precision * scale**2 + _RIDGE
        return rows, stops, rows @ rows.T + np.diag(prior), prior

    def discrimination(self, chosen: NDArray[np.intp]) -> float:
        """Lambda with the run and some of the candidates."""
        rows, stops, gram, prior = self.scaled()
        more = stops[:, chosen].reshape(len(rows), -1)
        there = self.there[:, chosen].reshape(len(self.signals), -1)
        moment = rows @ self.signals.T + more @ there.T
        eta = cho_solve(cho_factor(gram + more @ more.T, lower=True), moment)
        # by what is left over: the difference of two large squares would lose it
        left = float(np.sum((self.signals - eta.T @ rows) ** 2) + np.sum((there - eta.T @ more) ** 2))
        return (left + float(np.einsum("pk,p,pk->", eta, prior, eta))) / len(self.signals)

    def begin(self) -> Race:
        """The contest before the first further stop."""
        rows, stops, gram, prior = self.scaled()
        inverse = cho_solve(cho_factor(gram, lower=True), np.eye(len(gram)))
        eta = inverse @ (rows @ self.signals.T)
        left = float(np.sum((self.signals - eta.T @ rows) ** 2)) + float(np.einsum("pk,p,pk->", eta, prior, eta))
        by_stop = np.ascontiguousarray(stops.transpose(1, 2, 0))
        return Race(
            stops=by_stop,
            inverse=inverse,
            spread=np.einsum("mcp,mep->mce", by_stop @ inverse, by_stop, optimize=True),
            error=self.there - np.einsum("mcp,pk->kmc", by_stop, eta),
            value=left / len(self.signals),
        )


@dataclass(eq=False)
class Race:
    """A contest while stops are added.

    Of each candidate: its scaled columns ``stops`` (m, 3, p), the variance ``spread`` (m, 3, 3) of what the rival
    predicts there, and by how much it misses the signals, ``error`` (k, m, 3). ``inverse`` (p, p) is that of the normal
    matrix, ``value`` lambda.
    """

    stops: Array
    inverse: Array
    spread: Array
    error: Array
    value: float

    def gains(self) -> Array:
        """How much each candidate would add to lambda, (m,)."""
        weights = np.linalg.inv(np.eye(3) + self.spread)
        return np.asarray(np.einsum("kmc,mce,kme->m", self.error, weights, self.error, optimize=True)) / len(self.error)

    def take(self, stop: int) -> None:
        """Measure a candidate."""
        weight = np.linalg.inv(np.eye(3) + self.spread[stop])
        missed = self.error[:, stop].copy()
        gain = self.inverse @ self.stops[stop].T
        across = self.stops @ gain
        self.value += float(np.einsum("kc,ce,ke->", missed, weight, missed)) / len(self.error)
        self.error -= np.einsum("mce,kf,fe->kmc", across, missed, weight, optimize=True)
        self.spread -= across @ weight @ across.transpose(0, 2, 1)
        self.inverse -= gain @ weight @ gain.T
