"""Tuning of the non-linear constants of accepted laws (onset, time constant, knee, width).

Coordinate search: each constant moves to a nearby value if the term then explains more of the residual beside all other
terms; the step shrinks from round to round.
"""

from __future__ import annotations

from dataclasses import replace

from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms, refit
from cellapp.estimation.discovery.search.state import SearchProblem, SearchState, SearchStep
from cellapp.estimation.discovery.terms import ModelTerms, with_term
from cellapp.robot.effects import Law

_SHRINKAGE = (1.0, 1.0, 0.5, 0.5, 0.25, 0.12)
"""Factors on the step in each round, 0.3 in the logarithm of a constant: down to 4 %, finer than data determine a time
constant."""
_LEAST_IMPROVEMENT = 1e-9
"""Relative gain below which two values of a constant count as equal; above rounding errors."""


def apply_step(problem: SearchProblem, state: SearchState, step: SearchStep) -> SearchState:
    """Apply a step: refit with re-estimated weights, tune constants, add the step to the history."""
    data, fit = refit(state.data.at(state.fit.model), step.terms)
    tuned = _tuned_terms(data, fit)
    if tuned is not step.terms:
        data, fit = refit(data.at(fit.model), tuned)
    done = replace(step, terms=fit.terms, model=fit.model)
    return SearchState(data, fit, (*state.steps, done), state.dropped)


def _tuned_terms(data: ArmData, fit: JointFit) -> ModelTerms:
    """Tune the constants of all library effects, one after the other, with fixed weights."""
    for number, term in enumerate(fit.terms):
        if term.is_library_effect:
            law = _tuned_law(data, fit, number)
            if law is not term.law:
                fit = fit_terms(data, with_term(fit.terms, number, replace(term, law=law)))
    return fit.terms


def _tuned_law(data: ArmData, fit: JointFit, number: int) -> Law:
    """Return the law of a term with the constants that explain most; the law itself if none explains more."""
    term, residual = fit.terms[number], fit.residual_without(number)
    names = set(term.names)
    law, explained = term.law, residual.explained(fit.law_rows(number))
    for shrink in _SHRINKAGE:
        for nearby in law.nearby(data.context, shrink):
            columns = [column for column in data.columns(term.slug, nearby) if column.name in names]
            trial = residual.explained(fit.displacements(columns))
            if trial > explained * (1.0 + _LEAST_IMPROVEMENT):
                law, explained = nearby, trial
    return law
