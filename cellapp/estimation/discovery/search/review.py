"""Review of a model: drop terms made superfluous by others, and find alternatives of the remaining ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.design.information import SMALLEST, NuisanceProjector
from cellapp.estimation.discovery.arm_data import UNKNOWN, CandidateLaw, LawScore, ModelTerm, without_term
from cellapp.estimation.discovery.joint_fit import JointFit, ProjectedResidual, cross_validated_gain, fit_terms
from cellapp.estimation.discovery.records import RunnerUp
from cellapp.estimation.discovery.search.discrepancy_term import BesideField, explains_beside_discrepancies
from cellapp.estimation.discovery.search.scan import LawScan, choice_price
from cellapp.estimation.discovery.search.state import (
    NEARLY,
    SCORE_MARGIN,
    Review,
    SearchProblem,
    SearchState,
    SearchStep,
    apply_step,
    floor_reached,
    impossible_blocks,
    possible_score,
    within_bounds,
)
from cellapp.ground.counting import counted
from cellapp.robot.effects import EFFECTS, InputVariable
from cellapp.robot.effects.effect import borrowed, sentence
from cellapp.robot.effects.periodic import LINES
from cellapp.robot.kinematics.transforms import Array

_AS_WELL = 0.5
"""Share of the score of the parameters it replaces that an effect must reach: a fitted discrepancy term scores more."""
_SAME_SHAPE = 0.999
"""Cosine from which two columns are taken to move the SMR alike."""
SAME_CAUSE = 0.05
"""Share of a larger term's sum of squares. A term with common variables that removes less is taken for the residual of
the larger term's imperfect law (22 % in rms), not for a second cause."""


def reviewed(problem: SearchProblem, state: SearchState) -> SearchState:
    """Drop superfluous terms one by one, the weakest first; return the new state."""
    dropped = list(state.dropped)
    while True:
        problem.job.check()
        problem.say(f"review of {counted(len(state.fit.terms), 'effect')}")
        out = _weakest(problem, state)
        if out is None:
            out = _rest_of_a_law(state)
        if out is None:
            return replace(state, dropped=tuple(dropped))
        dropped.append(state.fit.terms[out].slug)
        state = problem.state(without_term(state.fit.terms, out), state)


def _weakest(problem: SearchProblem, state: SearchState) -> int | None:
    """Return the term with the least score if that does not pass the threshold; else None.

    Smooth terms have a test of their own; only beside a field over the workspace they are judged here too.
    """
    beside = BesideField.of(state.data, state.fit)
    scores = {}
    for number, term in enumerate(state.fit.terms):
        if term.smooth is None:
            scores[number] = term_score(state.fit, number)
        if beside is not None and number != beside.field:
            whole = beside.gain_of(number) - _price(state.fit, number)
            whole -= 2.0 * SCORE_MARGIN if term.slug == UNKNOWN else 0.0
            scores[number] = min(scores.get(number, math.inf), whole)
    weak = [number for number, score in scores.items() if score <= problem.threshold]
    return min(weak, key=lambda number: scores[number]) if weak else None


def _rest_of_a_law(state: SearchState) -> int | None:
    """Return a small term that shares variables with a far larger one; None if none, or at the noise floor."""
    fit = state.fit
    if floor_reached(state):
        return None
    removed = [fit.removed_square(number) for number in range(len(fit.terms))]
    for number, term in enumerate(fit.terms):
        for other, larger in enumerate(fit.terms):
            if UNKNOWN in (term.slug, larger.slug) or number == other:
                continue
            # all effects depend on the configuration: a common joint angle is no common cause
            shared = (EFFECTS[term.slug].variables & EFFECTS[larger.slug].variables) - {InputVariable.JOINT_ANGLE}
            if shared and removed[number] < SAME_CAUSE * removed[other]:
                return number
    return None


def term_score(fit: JointFit, number: int) -> float:
    """Return the score of a term with its law's present columns, beside all other terms."""
    return fit.residual_without(number).bic_gain(fit.law_rows(number)) - _price(fit, number)


def _price(fit: JointFit, number: int) -> float:
    """Return the price of choosing a term's law; lines pay it once each."""
    law = fit.terms[number].law
    return choice_price(law) * (len({column.block for column in fit.term_columns(number)}) if law.form == LINES else 1)


def review(problem: SearchProblem, state: SearchState, number: int) -> Review:
    """Review a term: its score beside all others, and the effects of the library that could take its place."""
    fit = state.fit
    term = fit.terms[number]
    if term.smooth is not None:
        return Review(term, term.smooth.evidence, problem.p_value(term.smooth.evidence), ())
    score = term_score(fit, number)
    if term.slug == UNKNOWN:
        return Review(term, score, problem.p_value(score), ())
    residual = fit.residual_without(number)
    others = [slug for slug in problem.slugs if slug not in state.slugs]
    best = state.scan(others).behind_of(residual.projector).best_of_each_effect(residual)
    alternatives = [
        RunnerUp(effect=one.slug, statistic=one.value, distinguishable=_explains_beside(problem, fit, number, one))
        for one in best
        if one.value > max(score - SCORE_MARGIN, 0.0)
    ]
    contained = _contained(problem, state, number)
    inside = {one.effect for one in contained}
    alternatives = [*(one for one in alternatives if one.effect not in inside), *contained]
    alternative_scores = {one.slug: one.value for one in best}
    alternative_scores |= {
        one.slug: possible_score(residual, one) for one in best if one.value > score - 2.0 * SCORE_MARGIN
    }
    return Review(term, score, problem.p_value(score), tuple(alternatives), alternative_scores)


def _contained(problem: SearchProblem, state: SearchState, number: int) -> list[RunnerUp]:
    """Find confounded effects that may hide in a term: in place of columns of the same shape, or of its discrepancy
    term.

    Dry friction and play move a joint alike, and the residual of a law may look like the other. Such an effect may be
    present beside the named one if, beside the rest of the law, it scores about as much as what it replaces.
    """
    fit, term = state.fit, state.fit.terms[number]
    if not term.is_library_effect:
        return []
    target, own = fit.residual_without(number).residual, fit.layout.parameters(number)
    of_law = slice(own.start, own.start + len(term.names))
    found = []
    for slug in EFFECTS[term.slug].confounded:
        laws = [] if slug in state.slugs else fit.candidates(state.data, [slug])
        if not laws:
            continue
        of_shape, free = np.zeros((2, fit.layout.total), dtype=bool)
        of_shape[of_law] = _shared_columns(fit.law_rows(number), laws)
        free[of_law.stop : own.stop] = True
        for replaced in (of_shape, free):
            if replaced.any() and not replaced[of_law].all():
                found += _in_place_of(problem, fit, replaced, target, laws)
    return list({one.effect: one for one in found}.values())


def _in_place_of(
    problem: SearchProblem, fit: JointFit, replaced: NDArray[np.bool_], target: Array, laws: Sequence[CandidateLaw]
) -> list[RunnerUp]:
    """Return the best of some laws as an alternative if it explains ``target`` like the ``replaced`` parameters."""
    projector = fit.projector_of(~replaced)
    rest = ProjectedResidual(projector, target)
    gain = math.log(rest.square / fit.projected_residual.square) * rest.freedom
    gain -= (fit.projector.effective_parameters - projector.effective_parameters) * math.log(rest.freedom)
    return [
        RunnerUp(effect=one.slug, statistic=one.value, distinguishable=False)
        for one in LawScan.of(laws, projector).ranked(rest)[:1]
        if one.value > max(problem.threshold, _AS_WELL * gain)
    ]


def _shared_columns(rows: Array, laws: Sequence[CandidateLaw]) -> NDArray[np.bool_]:
    """Return a mask of the rows (m, d) that equal a column of some law up to a factor."""
    shared = np.zeros(len(rows), dtype=bool)
    norms = np.maximum(np.linalg.norm(rows, axis=1), SMALLEST)
    for law in laws:
        cosines = rows @ law.rows.T / norms[:, None] / np.maximum(np.linalg.norm(law.rows, axis=1), SMALLEST)
        shared |= (np.abs(cosines) > _SAME_SHAPE).any(axis=1)
    return shared


def _explains_beside(problem: SearchProblem, fit: JointFit, number: int, one: LawScore) -> bool:
    """Return whether a term still passes the threshold in a model that contains the alternative."""
    kept = fit.layout.all_but(number)
    rows = np.concatenate([fit.rows[kept], one.rows])
    precision = np.concatenate([fit.precision[kept], np.zeros(len(one.chosen))])
    residual = ProjectedResidual(NuisanceProjector.of(rows, precision), fit.residual_without(number).residual)
    score = residual.bic_gain(fit.law_rows(number))
    return score > problem.threshold


# -- Laws of the library that describe the residual only with physically impossible values ----------------------------
#
# Such a law is not the effect that it is named after, but there is a real cause. It joins the model as an unknown
# effect whose sentence says what it behaves like and what to check.


_TRIED = 6
"""Number of best laws whose values are fitted in full: the law with the right inputs is among the first."""
MOSTLY = 0.5
"""Share of the explained sum of squares that blocks with impossible values must hold: a negative value at one joint of
many is an alias, and does not contradict the law."""


def with_contradiction(problem: SearchProblem, state: SearchState) -> SearchState | None:
    """Add the law that explains most with impossible values; None if none holds."""
    step = _contradiction(problem, state)
    return None if step is None else apply_step(state, step)


def _contradiction(problem: SearchProblem, state: SearchState) -> SearchStep | None:
    fit, residual = state.fit, state.fit.projected_residual
    scan = LawScan.of(_unused(state, fit.candidates(state.data, problem.slugs)), fit.projector)
    for score in scan.ranked(residual, least=problem.threshold)[:_TRIED]:
        if score.value <= problem.threshold:
            break
        if not impossible_blocks(residual, score, NEARLY)[0] or _confounded_explains_more(state, score):
            continue
        term = _impossible_term(state, score)
        if term is None:
            continue
        possible = within_bounds(state.data, fit.terms, residual, score)
        remaining = 0.0 if possible is None else max(possible.value, 0.0)
        if score.value - remaining <= max(problem.threshold, SCORE_MARGIN):
            continue
        if explains_beside_discrepancies(problem, state, score) and (
            cross_validated_gain(state.data, fit, score.rows) > 0.0
        ):
            return problem.step(UNKNOWN, term.note, score.value, (*fit.terms, term))
    return None


def _confounded_explains_more(state: SearchState, score: LawScore) -> bool:
    """Return whether a named confounded effect explains far more: an impossible law beside it is only that law's
    residual."""
    explained = score.explained_share * state.fit.projected_residual.square
    return any(
        explained < SAME_CAUSE * state.fit.removed_square(number)
        for number, term in enumerate(state.fit.terms)
        if term.is_library_effect and score.slug in EFFECTS[term.slug].confounded
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
    unbounded = borrowed("contradiction", effect, law.form).law(law.constants, law.tried)
    return ModelTerm(UNKNOWN, unbounded, score.names, note=note)


def share_of(fit: JointFit, number: int, some: Sequence[bool]) -> float:
    """Return the share of a term's visible signal that the columns in the mask ``some`` hold."""
    projector, chosen = fit.residual_without(number).projector, np.array(some)
    values, rows = fit.term_values(number), fit.term_rows(number)
    parts = projector.project(np.stack([values[chosen] @ rows[chosen], values[~chosen] @ rows[~chosen]]))
    squares = np.sum(parts**2, axis=1)
    return float(squares[0] / max(float(squares.sum()), 1e-300))
