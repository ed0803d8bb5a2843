"""Bounds of a choice of stops: optimal weights of all candidates, of which a choice is a special case.

A design with weights w_i in [0, 1], sum w_i = n, has the information P + sum_i w_i x_i^T x_i. Each of the three
errors of the criterion is convex in it, so that its tangent bounds it from below at every other design (Fedorov 1972,
chapter 2):

    error* >= error (1 - (largest n of g - sum_i w_i g_i)),    g_i = tr(x_i C W C x_i^T),  W = d ln(error) / dC.

The weights are improved by the multiplicative rule w_i <- w_i sqrt(g_i) (Silvey, Titterington, Torsney, Commun. Stat.
Theory Methods 7 (1978) 1379).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.estimation.calibration.least_squares import inverse_psd
from cellapp.estimation.design.block_design import Candidates, Criterion, DesignErrors, Shares
from cellapp.ground.progress import CancelToken
from cellapp.robot.kinematics.transforms import Array

_ONLY = (Shares(1.0, 0.0, 0.0), Shares(0.0, 1.0, 0.0), Shares(0.0, 0.0, 1.0))
_CAPPINGS = 10
"""Most rounds of redistributing weight in excess of 1 to the other candidates; few candidates reach it."""


def least_errors(
    candidates: Candidates, count: int, criterion: Criterion, rounds: int, cancel: CancelToken
) -> DesignErrors:
    """Return lower bounds of the errors of any choice of ``count`` candidates; more ``rounds`` make them sharper.

    Each error is bounded alone. The bound for the worst point is that of the power mean, which is below the largest
    value.
    """
    return DesignErrors(*(_least(candidates, count, replace(criterion, shares=only), rounds, cancel) for only in _ONLY))


def _least(candidates: Candidates, count: int, criterion: Criterion, rounds: int, cancel: CancelToken) -> float:
    flat = candidates.rows.reshape(-1, candidates.rows.shape[2])
    count = min(count, len(candidates))
    weights = np.full(len(candidates), count / len(candidates))
    best = 0.0
    for _ in range(rounds):
        cancel.check()
        covariance = inverse_psd(candidates.prior + (flat * np.repeat(weights, 3)[:, None]).T @ flat)
        tangent = covariance @ criterion.weights(covariance) @ covariance
        slope = np.einsum("rp,rp->r", flat @ tangent, flat).reshape(-1, 3).sum(axis=1)
        gap = float(np.sort(slope)[len(slope) - count :].sum() - weights @ slope)
        best = max(best, np.exp(criterion.value(covariance)) * (1.0 - gap))
        weights = _capped(weights * np.sqrt(slope), count)
    return best


def _capped(weights: Array, count: int) -> Array:
    """Limit weights to at most 1 with the sum ``count``, in proportion to the given ones where they are below 1."""
    for _ in range(_CAPPINGS):
        full = weights >= 1.0
        weights = np.where(full, 1.0, weights * ((count - full.sum()) / max(weights[~full].sum(), 1e-300)))
    return np.minimum(weights, 1.0)
