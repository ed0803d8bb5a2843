"""Comparison of fitted models: remaining scatter against the noise floor, and the Bayesian information criterion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cellapp.estimation.calibration.quantities import states_nothing
from cellapp.estimation.discovery.arm_data import ArmData, whitening
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.search.scan import choice_price
from cellapp.estimation.discovery.search.state import SCORE_MARGIN, SearchState
from cellapp.estimation.discovery.terms import UNKNOWN

FLOOR_CHANCE = 0.001
"""p-value of the remaining scatter above which it counts as noise; below, the search goes on."""


@dataclass(frozen=True)
class Scatter:
    """Scatter of residuals relative to the stated uncertainty.

    ``ratio`` is the root of chi-square per degree of freedom, ``p_value`` the probability of one at least as large.
    """

    ratio: float
    p_value: float


def scatter(data: ArmData, fit: JointFit) -> Scatter | None:
    """Compute the scatter that a model leaves; None if the readings state no uncertainty."""
    if data.stated is None:
        return None
    squares = np.sum(np.einsum("acn,nc->an", whitening(data.stated), fit.identification.residuals) ** 2, axis=0)
    total, freedom = float(squares.sum()), 3.0 * len(data) - fit.projector.effective_parameters
    for kind in () if data.turned is None else (data.turned, ~data.turned):
        if states_nothing(data.stated[kind]):
            total -= float(squares[kind].sum())
            freedom -= 3.0 * np.count_nonzero(kind) - float(np.sum(fit.projector.basis[np.tile(kind, 3)] ** 2))
    if total <= 0.0:
        return None
    freedom = max(freedom, 1.0)
    return Scatter(math.sqrt(total / freedom), float(scipy.special.chdtrc(freedom, total)))


def floor_reached(state: SearchState) -> bool:
    """Return whether the remaining scatter may be the stated noise; False if none is stated."""
    found = scatter(state.data, state.fit)
    return found is not None and found.p_value > FLOOR_CHANCE


def best_state(states: Sequence[SearchState]) -> SearchState:
    """Return the state with the least criterion."""
    return min(states, key=lambda state: criterion(state.fit))


def criterion(fit: JointFit) -> float:
    """Return the Bayesian information criterion of a model plus the prices of laws and hyperparameters."""
    price = 0.0
    for term in fit.terms:
        price += choice_price(term.law) + SCORE_MARGIN * (2.0 if term.slug == UNKNOWN else 1.0)
        if term.smooth is not None:
            price += term.smooth.hyperparameters * math.log(len(fit.residual))
    return fit.information_criterion + price
