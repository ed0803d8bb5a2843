"""Refinement of an effect in the model: another law of it, further joints, or sharp lines beside a free curve.

The law of the first effect is refined before a second one is named, as the residual of an imperfect law can look like
another effect.
"""

from __future__ import annotations

import math
from dataclasses import replace

from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.discovery.candidates import CandidateLaw, LawScore
from cellapp.estimation.discovery.joint_fit import fit_terms
from cellapp.estimation.discovery.search.bounds import within_bounds
from cellapp.estimation.discovery.search.review import term_score
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.shared_lines import shared_lines
from cellapp.estimation.discovery.search.state import SearchProblem, SearchState, SearchStep
from cellapp.estimation.discovery.terms import ModelTerm, with_term, without_term
from cellapp.robot.effects import EFFECTS
from cellapp.robot.effects.periodic import CURVE, LINE_AMPLITUDE, LINES, lines_beside

MANY_LINES = 10
"""Number of columns of a transmission error from which free curves are tried instead: five lines, more than a drive's
first harmonics."""
_TRIED = 3
"""Number of best laws of an effect that are fitted in full to check their bounds; each costs a joint fit."""


def refinement(problem: SearchProblem, state: SearchState, needed: float) -> SearchStep | None:
    """Return the refinement with the largest gain above ``needed``; None if there is none."""
    best: SearchStep | None = None
    for number, term in enumerate(state.fit.terms):
        least = needed if best is None else best.score
        if term.law.form == CURVE:
            best = _lines_beside_curves(problem, state, number, least) or best
        elif term.is_library_effect:
            best = _better_law(problem, state, number, least) or best
            best = _further_block(problem, state, number, least if best is None else best.score) or best
    return best


def _better_law(problem: SearchProblem, state: SearchState, number: int, needed: float) -> SearchStep | None:
    """Return a step to the best other law, or other columns, of a term; None if none gains more than ``needed``."""
    data, fit = state.data, state.fit
    term, residual = fit.terms[number], fit.residual_without(number)
    own = term_score(fit, number)
    best: SearchStep | None = None
    scan = LawScan.of(_laws_to_try(state, number), residual.projector)
    for score in scan.ranked(residual, with_refinements=True, least=own + needed)[:_TRIED]:
        least = needed if best is None else best.score
        same = score.candidate.law.name == term.law.name and set(score.names) == set(term.names)
        if same or score.value - own <= least:
            continue
        possible = within_bounds(data, without_term(fit.terms, number), residual, score)
        if possible is None or possible.value - own <= least:
            continue
        best = _refined(problem, state, number, possible, possible.value - own)
    return best


def _further_block(problem: SearchProblem, state: SearchState, number: int, needed: float) -> SearchStep | None:
    """Return a step to one more joint or refining column beside all that a term has, its free part included; else None.

    Selecting the whole law again would omit the free part, and its residual hides small blocks.
    """
    fit, term = state.fit, state.fit.terms[number]
    if term.law.form == LINES:  # each further line has a price of its own
        return None
    candidate = fit.candidate(state.data, term.slug, term.law)
    unused = candidate.keep([place for place, one in enumerate(candidate.columns) if one.name not in term.names])
    gains = [(fit.projected_residual.bic_gain(unused.rows[list(block)]), block) for block in unused.blocks]
    score, block = max(gains, default=(-math.inf, ()))
    if score <= needed:
        return None
    names = (*term.names, *(unused.columns[place].name for place in block))
    terms = with_term(fit.terms, number, replace(term, names=names))
    where = unused.columns[block[0]].block
    try:
        trial = fit_terms(state.data, terms)
    except TooFewReadings:  # the readings do not determine all its columns
        return None
    if where in trial.blocks_beyond_bounds(number):
        return None
    return problem.step(term.slug, f"{EFFECTS[term.slug].title}: {where} as well", score, terms)


def _refined(problem: SearchProblem, state: SearchState, number: int, score: LawScore, gain: float) -> SearchStep:
    """Return the step that replaces the law of a term by that of ``score``."""
    term = ModelTerm(score.slug, score.candidate.law, score.names)
    words = term.law.name.replace("_", " ") or "more of it"
    terms = with_term(state.fit.terms, number, term)
    return problem.step(term.slug, f"{EFFECTS[term.slug].title}: {words}", gain, terms)


def _laws_to_try(state: SearchState, number: int) -> list[CandidateLaw]:
    """Return all laws of a term's effect, its own with tuned constants, and those that its columns suggest."""
    data, fit = state.data, state.fit
    term = fit.terms[number]
    candidates = fit.candidates(data, [term.slug])
    if all(one.law != term.law for one in candidates):
        candidates.append(fit.candidate(data, term.slug, term.law))
    if len(term.names) >= MANY_LINES:  # a curve comes before one more line
        candidates = [one for one in candidates if len(one.columns) <= 2 * MANY_LINES]
    laws = EFFECTS[term.slug].refinements(data.context, term.law, term.names)
    return [*candidates, *(fit.candidate(data, term.slug, law) for law in laws)]


def _lines_beside_curves(problem: SearchProblem, state: SearchState, number: int, needed: float) -> SearchStep | None:
    """Return a step to sharp lines of more cycles than smooth curves reach, searched once; None if none."""
    data, fit = state.data, state.fit
    term = fit.terms[number]
    if LINE_AMPLITUDE.name in term.law.constants:
        return None
    beyond = lines_beside(data.context, term.law)
    candidate = CandidateLaw(term.slug, term.law, tuple(beyond), fit.displacements(beyond))
    found = shared_lines(candidate, fit.projected_residual, fit.by_joint)
    if found is None or found.value <= max(needed, problem.threshold):
        return None
    names = tuple(beyond[place].name for place in found.columns)
    constants = {**term.law.constants, LINE_AMPLITUDE.name: found.amplitude}
    law = replace(term.law, constants=constants, tried=term.law.tried * found.tried)
    terms = with_term(fit.terms, number, replace(term, law=law, names=(*term.names, *names)))
    return problem.step(term.slug, f"{EFFECTS[term.slug].title}: lines beside the curve", found.value, terms)
