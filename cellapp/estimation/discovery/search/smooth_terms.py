"""Smooth free functions beside, or in place of, the effects found: the structured process as a step of the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from cellapp.estimation.discovery.joint_fit import refit
from cellapp.estimation.discovery.process.components import Component, components
from cellapp.estimation.discovery.process.structured import fit_process, process_terms
from cellapp.estimation.discovery.search.state import SCORE_MARGIN, SearchProblem, SearchState
from cellapp.estimation.discovery.terms import has_smooth_terms
from cellapp.robot.effects import EFFECTS, DriverVariable
from cellapp.robot.effects.base_motion import BaseDrift
from cellapp.robot.effects.thermal import JointDrift


def with_smooth_terms(problem: SearchProblem, state: SearchState) -> SearchState | None:
    """Add the smooth terms that the residuals need; None if they need none or the state already has some."""
    if has_smooth_terms(state.fit.terms):
        return None
    problem.say("free functions of joints, loads and time")
    return _with_process(problem, state)


def with_one_drift(problem: SearchProblem, state: SearchState) -> SearchState | None:
    """Replace the effects of time by a smooth drift of base or joint zeros; None if there are fewer than two.

    A wandering drift looks like a sequence of steps and warm-ups.
    """
    of_time = [
        term.is_library_effect and DriverVariable.TIME in EFFECTS[term.slug].variables for term in state.fit.terms
    ]
    if sum(of_time) < 2 or has_smooth_terms(state.fit.terms):
        return None
    others = tuple(term for term, out in zip(state.fit.terms, of_time, strict=True) if not out)
    rest = problem.state(others, state)
    drifts = [one for one in components(rest.data, rest.fit) if one.slug in (BaseDrift.slug, JointDrift.slug)]
    return _with_process(problem, rest, drifts)


def _with_process(
    problem: SearchProblem, state: SearchState, candidates: Sequence[Component] | None = None
) -> SearchState | None:
    """Add the smooth terms that the residuals need, of ``candidates`` or of all; None if they need none."""
    found = fit_process(state.data, state.fit, max(problem.threshold, SCORE_MARGIN), candidates)
    if found is None:
        return None
    terms = (*state.fit.terms, *process_terms(*found))
    data, fit = refit(state.data.at(state.fit.model), terms)
    steps = list(state.steps)
    for number in range(len(state.fit.terms), len(terms)):
        term = fit.terms[number]
        assert term.smooth is not None
        what = f"{EFFECTS[term.slug].title}: {term.law.form.words}"
        steps.append(problem.step(term.slug, what, term.smooth.evidence, terms[: number + 1]))
    steps[-1] = replace(steps[-1], model=fit.model)
    return SearchState(data, fit, tuple(steps), state.dropped)
