"""Laws of the library that describe the residual only with physically impossible values.

Such a law is not the effect that it is named after, but there is a real cause. It joins the model as an unknown effect
whose sentence says what it behaves like and what to check.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.discovery.candidates import CandidateLaw, LawScore
from cellapp.estimation.discovery.cross_validation import cross_validated_gain
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms
from cellapp.estimation.discovery.search.bounds import NEARLY, impossible_blocks, within_bounds
from cellapp.estimation.discovery.search.free_part import explains_beside_free_parts
from cellapp.estimation.discovery.search.review import SAME_CAUSE
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.state import SCORE_MARGIN, SearchProblem, SearchState, SearchStep
from cellapp.estimation.discovery.search.tuning import apply_step
from cellapp.estimation.discovery.terms import UNKNOWN, ModelTerm
from cellapp.robot.effects import EFFECTS
from cellapp.robot.effects.contradiction import form_without_bounds, sentence

_TRIED = 6
"""Number of best laws whose values are fitted in full: the law with the right drivers is among the first."""
MOSTLY = 0.5
"""Share of the explained sum of squares that blocks with impossible values must hold: a negative value at one joint of
many is an alias, and does not contradict the law."""


def with_contradiction(problem: SearchProblem, state: SearchState) -> SearchState | None:
    """Add the law that explains most with impossible values; None if none holds."""
    step = _contradiction(problem, state)
    return None if step is None else apply_step(problem, state, step)


def _contradiction(problem: SearchProblem, state: SearchState) -> SearchStep | None:
    fit, residual = state.fit, state.fit.projected_residual
    scan = LawScan.of(_unused(state, fit.candidates(state.data, problem.slugs)), fit.projector)
    for score in scan.ranked(residual, least=problem.threshold)[:_TRIED]:
        if score.value <= problem.threshold:
            break
        if not impossible_blocks(residual, score, NEARLY)[0] or _left_over(state, score):
            continue
        term = _impossible_term(state, score)
        if term is None:
            continue
        possible = within_bounds(state.data, fit.terms, residual, score)
        remaining = 0.0 if possible is None else max(possible.value, 0.0)
        if score.value - remaining <= max(problem.threshold, SCORE_MARGIN):
            continue
        if explains_beside_free_parts(problem, state, score) and (
            cross_validated_gain(state.data, fit, score.rows) > 0.0
        ):
            return problem.step(UNKNOWN, term.note, score.value, (*fit.terms, term))
    return None


def _left_over(state: SearchState, score: LawScore) -> bool:
    """Return whether a named look-alike explains far more: an impossible law beside it is only that law's residual."""
    explained = score.explained_share * state.fit.projected_residual.square
    return any(
        explained < SAME_CAUSE * state.fit.removed_square(number)
        for number, term in enumerate(state.fit.terms)
        if term.is_library_effect and score.slug in EFFECTS[term.slug].look_alikes
    )


def _unused(state: SearchState, candidates: list[CandidateLaw]) -> list[CandidateLaw]:
    """Return the laws without the columns that the model already has."""
    taken = {(term.slug, name) for term in state.fit.terms for name in term.names}
    kept = []
    for one in candidates:
        places = [place for place, column in enumerate(one.columns) if (one.slug, column.name) not in taken]
        if places:
            kept.append(one if len(places) == len(one.columns) else one.keep(places))
    return kept


def _impossible_term(state: SearchState, score: LawScore) -> ModelTerm | None:
    """Return the law as a term without bounds, with its sentence; None if its values are mostly possible."""
    terms, effect = state.fit.terms, EFFECTS[score.slug]
    law = score.candidate.law
    try:
        trial = fit_terms(state.data, (*terms, ModelTerm(score.slug, law, score.names)))
    except TooFewReadings:  # the readings do not determine all its columns
        return None
    blocks = trial.blocks_beyond_bounds(len(terms))
    if (
        not blocks
        or share_of(trial, len(terms), [column.block in blocks for column in trial.term_columns(len(terms))]) < MOSTLY
    ):
        return None
    outside = [
        (column, value)
        for column, value in zip(trial.term_columns(len(terms)), trial.term_values(len(terms)).tolist(), strict=True)
        if not column.lower <= value <= column.upper
    ]
    note = sentence(effect, [column for column, _ in outside], [value for _, value in outside])
    unbounded = form_without_bounds(effect, law.form).law(law.constants, law.tried)
    return ModelTerm(UNKNOWN, unbounded, score.names, note=note)


def share_of(fit: JointFit, number: int, some: Sequence[bool]) -> float:
    """Return the share of a term's visible signal that the columns in the mask ``some`` hold."""
    projector, chosen = fit.residual_without(number).projector, np.array(some)
    values, rows = fit.term_values(number), fit.term_rows(number)
    parts = projector.project(np.stack([values[chosen] @ rows[chosen], values[~chosen] @ rows[~chosen]]))
    squares = np.sum(parts**2, axis=1)
    return float(squares[0] / max(float(squares.sum()), 1e-300))
