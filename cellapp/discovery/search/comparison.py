"""Comparison of fitted models: remaining scatter against the noise floor, and the Bayesian information criterion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from cellapp.design.information import NuisanceProjector
from cellapp.discovery.arm_data import ArmData, whitening
from cellapp.discovery.joint_fit import JointFit
from cellapp.discovery.search.scan import choice_price
from cellapp.discovery.search.state import SCORE_MARGIN, SearchState
from cellapp.discovery.terms import UNKNOWN
from cellapp.kinematics.transforms import Array

FLOOR_CHANCE = 0.001
"""Chance of the remaining scatter above which it counts as noise; the search goes on below."""


@dataclass(frozen=True)
class Scatter:
    """Scatter of residuals against the stated uncertainty.

    ``ratio`` is the root of chi-square per degree of freedom, ``p_value`` the chance of one at least as large.
    """

    ratio: float
    p_value: float


def scatter(data: ArmData, fit: JointFit) -> Scatter | None:
    """Scatter that a model leaves; None where the readings state no uncertainty."""
    if data.stated is None:
        return None
    total = unexplained_square(data, fit)
    freedom = max(3.0 * len(data) - fit.projector.effective_parameters, 1.0)
    return Scatter(math.sqrt(total / freedom), float(chi2.sf(total, freedom)))


def floor_reached(state: SearchState) -> bool:
    """Whether the remaining scatter may be the stated noise; False where none is stated."""
    found = scatter(state.data, state.fit)
    return found is not None and found.p_value > FLOOR_CHANCE


def unexplained_square(data: ArmData, fit: JointFit) -> float:
    """Sum of squares of the residuals in units of the stated uncertainty."""
    white = whitening(data.stated, len(data))
    return float(np.sum(np.einsum("acn,nc->an", white, fit.identification.residuals) ** 2))


def best_state(states: Sequence[SearchState]) -> SearchState:
    """The state with the least criterion."""
    return min(states, key=lambda state: criterion(state.fit))


def criterion(fit: JointFit) -> float:
    """Minus twice the log marginal likelihood of a model, and the prices of choosing laws.

    Parameters with a smooth prior are integrated out; the others, and the hyperparameters, cost ln N each, as in the
    Bayesian information criterion.
    """
    N, first = len(fit.residual), fit.layout.geometric
    smooth = np.zeros(len(fit.precision), dtype=bool)
    smooth[first:] = fit.precision[first:] > 0.0
    values = fit.identification.values
    square = float(fit.residual @ fit.residual) + float(fit.precision[smooth] @ values[smooth] ** 2)
    log_variance = -2.0 * float(np.sum(np.log(np.einsum("aan->an", fit.white))))
    flat = NuisanceProjector.of(fit.rows[~smooth], fit.precision[~smooth])
    price = flat.effective_parameters * math.log(N)
    for term in fit.terms:
        price += choice_price(term.law) + SCORE_MARGIN * (2.0 if term.slug == UNKNOWN else 1.0)
        if term.smooth is not None:
            price += term.smooth.hyperparameters * math.log(N)
    return square + log_variance + price + _log_occam(fit.rows[smooth], fit.precision[smooth], flat)


def _log_occam(rows: Array, precision: Array, flat: NuisanceProjector) -> float:
    """Log determinant of ``I + V^1/2 S M S^T V^1/2`` of smooth columns S behind the other parameters, V their prior."""
    if not len(rows):
        return 0.0
    explained = rows @ flat.basis
    root = 1.0 / np.sqrt(precision)
    gram = (rows @ rows.T - explained @ explained.T) * (root[:, None] * root)
    gram[np.diag_indices_from(gram)] += 1.0
    return 2.0 * float(np.sum(np.log(np.diag(np.linalg.cholesky(gram)))))
