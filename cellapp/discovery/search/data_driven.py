"""Data-driven terms for what no effect of the library explains: one channel as a function of one or two variables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellapp.discovery.arm_data import ArmData
from cellapp.discovery.candidates import LawScore
from cellapp.discovery.cross_validation import cross_validated_gain
from cellapp.discovery.search.comparison import best_state, floor_reached
from cellapp.discovery.search.scan import LawScan
from cellapp.discovery.search.state import SCORE_MARGIN, SearchProblem, SearchState
from cellapp.discovery.search.tuning import apply_step
from cellapp.discovery.terms import UNKNOWN, ModelTerm, ModelTerms
from cellapp.effects import Law
from cellapp.effects.contradiction import is_contradiction
from cellapp.effects.data_driven import data_driven_form
from cellapp.effects.unknown import dictionary, pairs

_MOST_TERMS = 3
"""Data-driven terms at most: a shift has three directions."""
_COORDINATES_EACH = 4
"""Measured coordinates that each parameter of a model with a data-driven term needs; with fewer it could fit noise."""
_LAWS_AT_ONCE = 200
"""Laws whose columns are held together: bounds the memory (200 laws of 20 columns and 1800 coordinates: 60 MB)."""


def with_data_driven_terms(problem: SearchProblem, state: SearchState) -> SearchState | None:
    """The state with data-driven terms; None where none holds."""
    driven = _with_term(problem, state)
    for _ in range(_MOST_TERMS - 1):
        if driven is None or floor_reached(driven):
            break
        further = _with_term(problem, driven)
        if further is None:
            break
        driven = further
    return driven


def _with_term(problem: SearchProblem, state: SearchState) -> SearchState | None:
    """The state with the data-driven term that explains most of the residual; None where none holds."""
    data, fit = state.data, state.fit
    score = next((one for one in _best_scores(problem, state) if cross_validated_gain(data, fit, one.rows) > 0.0), None)
    if score is None:
        return None
    law = score.candidate.law
    choices: list[ModelTerms] = [(*fit.terms, ModelTerm(UNKNOWN, law, score.names))]
    # The term describes its channel as any function of its variables: named effects that described a part may go.
    where = score.candidate.columns[0].where
    others = tuple(term for term in fit.terms if not _acts_only_on(data, term, where))
    if len(others) < len(fit.terms):
        names = tuple(column.name for column in data.columns(UNKNOWN, law))
        choices.append((*others, ModelTerm(UNKNOWN, law, names)))
    steps = [problem.step(UNKNOWN, "a data-driven term added", score.value, terms) for terms in choices]
    return best_state([apply_step(problem, state, step) for step in steps])


def _best_scores(problem: SearchProblem, state: SearchState) -> list[LawScore]:
    """The best law of two variables and of one that pass the threshold, the preferred one first."""
    data, fit = state.data, state.fit
    taken = {
        data_driven_form(term.law).subject
        for term in fit.terms
        if term.slug == UNKNOWN and not is_contradiction(term.law)
    }
    one = _best_law(state, [law for law in dictionary(data.context) if data_driven_form(law).subject not in taken])
    of_two = list(pairs(data.context))
    if one is not None:
        channel = data_driven_form(one.candidate.law).channel
        known = {law.name for law in of_two}
        of_two += [law for law in pairs(data.context, channel) if law.name not in known]
    two = _best_law(state, [law for law in of_two if data_driven_form(law).subject not in taken])
    found = [score for score in (two, one) if score is not None and score.value > problem.threshold]
    if len(found) == 2 and found[0].value <= found[1].value + SCORE_MARGIN:
        return found[1:]
    return found


def _best_law(state: SearchState, laws: Sequence[Law]) -> LawScore | None:
    """The best of many data-driven laws, less the price of choosing among them."""
    data, fit = state.data, state.fit
    fitted = int(np.count_nonzero(fit.precision == 0.0)) + fit.layout.geometric
    residual = fit.projected_residual
    best: LawScore | None = None
    for begin in range(0, len(laws), _LAWS_AT_ONCE):
        candidates = [fit.candidate(data, UNKNOWN, law) for law in laws[begin : begin + _LAWS_AT_ONCE]]
        candidates = [one for one in candidates if _COORDINATES_EACH * (len(one.columns) + fitted) <= 3 * len(data)]
        for score in LawScan.of(candidates, fit.projector).ranked(residual)[:1]:
            if best is None or score.value > best.value:
                best = score
    return None if best is None else replace(best, value=best.value - 2.0 * math.log(max(len(laws), 1)))


def _acts_only_on(data: ArmData, term: ModelTerm, where: str) -> bool:
    """Whether a named term acts on one place alone."""
    if not term.is_library_effect:
        return False
    return {column.where for column in data.columns(term.slug, term.law, term.names)} == {where}
