"""Comparison of fitted models: remaining scatter against the noise floor, and the Bayesian information criterion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from cellapp.calibration.curve_prior import CurvePrior
from cellapp.discovery.arm_data import ArmData, whitening
from cellapp.discovery.joint_fit import JointFit
from cellapp.discovery.search.scan import choice_price
from cellapp.discovery.search.state import SCORE_MARGIN, SearchProblem, SearchState
from cellapp.discovery.terms import UNKNOWN, curve_prior_of, has_curves

FLOOR_CHANCE = 0.001
"""Chance of the remaining scatter above which it counts as noise; the search goes on below."""
_DOMINANT = 0.9
"""Share of what a data-driven model explains from which named effects alone are taken as the explanation."""


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


def curve_price(curves: CurvePrior, coordinates: int) -> float:
    """BIC price of a curve prior: length scale and amplitude of each joint, and the noise."""
    return (2 * len(curves.joints) + 1) * math.log(coordinates)


def best_state(problem: SearchProblem, states: Sequence[SearchState]) -> SearchState:
    """The state with the least criterion.

    Where only some have free curves, those are judged by their evidence: it integrates over the coefficients, which the
    BIC would count.
    """
    curved = {has_curves(state.fit.terms) for state in states}
    criterion = _criterion_by_evidence if len(curved) > 1 else _criterion
    return min(states, key=lambda state: criterion(problem, state))


def _criterion(problem: SearchProblem, state: SearchState) -> float:
    """Bayesian information criterion with the stated uncertainty as weights, and the prices of choosing laws."""
    fit, N = state.fit, 3 * len(state.data)
    price = fit.projector.effective_parameters * math.log(N)
    for term in fit.terms:
        price += choice_price(term.law) + SCORE_MARGIN * (2.0 if term.slug == UNKNOWN else 1.0)
    return N * math.log(unexplained_square(state.data, fit)) + price


def _criterion_by_evidence(problem: SearchProblem, state: SearchState) -> float:
    """The criterion without the term of free curves, less their evidence."""
    curves = curve_prior_of(state.fit.terms)
    if curves is None:
        return _criterion(problem, state)
    rest = tuple(term for term in state.fit.terms if term.curves is None)
    gain = curves.evidence - curve_price(curves, 3 * len(state.data))
    return _criterion(problem, problem.state(rest)) - gain + SCORE_MARGIN


def names_dominate(problem: SearchProblem, named: SearchState, extended: SearchState) -> bool:
    """Whether named effects explain nearly all that a model with data-driven terms explains."""
    nothing = problem.state(())
    without = unexplained_square(nothing.data, nothing.fit)
    by_names = without - unexplained_square(named.data, named.fit)
    return by_names > _DOMINANT * (without - unexplained_square(extended.data, extended.fit))
