"""Data-driven terms for what no effect of the library explains: a function of one or two variables in one place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.design.information import SMALLEST, VISIBLE
from cellapp.estimation.discovery.arm_data import (
    TRANSMISSION_ERROR,
    UNKNOWN,
    ArmData,
    LawScore,
    ModelTerm,
    ModelTerms,
    with_term,
)
from cellapp.estimation.discovery.joint_fit import JointFit, cross_validated_gain
from cellapp.estimation.discovery.posterior import (
    COORDINATES_EACH,
    DirectionScan,
    Families,
    fitted_parameters,
    is_free_function,
)
from cellapp.estimation.discovery.search.discrepancy_term import explains_beside_discrepancies
from cellapp.estimation.discovery.search.review import MOSTLY, share_of
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.state import (
    SCORE_MARGIN,
    SearchProblem,
    SearchState,
    apply_step,
    best_state,
    criterion,
    floor_reached,
    scatter,
)
from cellapp.robot.effects import EFFECTS, InputVariable
from cellapp.robot.effects.data_driven import ActedOn, acted_on, data_driven_form
from cellapp.robot.effects.effect import borrowed, is_borrowed, place_in_words
from cellapp.robot.effects.law import AMPLITUDE
from cellapp.robot.effects.unknown import FunctionFamily, curve_families, own_angles, pair_families

_MOST_TERMS = 3
"""Most data-driven terms in a model: a shift has three directions."""
_LEAST_SHARE = 0.1
"""Least share of the remaining sum of squares beyond the noise that a term must explain: 5 % of the rms error. A check
on a hundred held-out stops cannot show less: its rms has a standard error of 4 %, 1 / sqrt(2 x 300 coordinates)."""
_PROMISE = 0.67
"""Ratio of a term's scan score to the gain of a fitted model from which the term may be better. The scan weights all
coordinates alike while the effect is still in the residual, so its scores are up to 30 % too low."""
_SELECTED = 5
"""Number of best laws whose columns are computed: the selection drops invisible columns, which changes a score
little."""


def with_data_driven_terms(
    problem: SearchProblem, state: SearchState, lead: float = 0.0, most: int = _MOST_TERMS
) -> SearchState | None:
    """Add data-driven terms to the state; None if none holds, or if the most terms could not make up for a ``lead``.

    ``lead`` is the criterion by which another model is better.
    """
    scores = _best_scores(problem, state)
    if not scores or most * max(score.value for score in scores) <= _PROMISE * lead:
        return None
    driven = _with_term(problem, state, scores)
    for _ in range(most - 1):
        if driven is None or floor_reached(driven):
            break
        further = _with_term(problem, driven, _best_scores(problem, driven))
        if further is None:
            break
        driven = further
    return driven


def in_place_of_names(problem: SearchProblem, start: SearchState, best: SearchState) -> SearchState | None:
    """Return data-driven terms on the geometry alone if one of them promises about as much as ``best``; else None.

    Several names, or a free function, can imitate one law that the library lacks. ``start`` is the geometry alone. A
    law replaces nothing if a named effect of its place and variable has a free function of its own.
    """
    if not best.fit.terms:
        return None
    best.give_up_scan()
    gain = criterion(start.fit) - criterion(best.fit)
    scores = _best_scores(problem, start)
    if not scores or max(score.value for score in scores) <= _PROMISE * gain:
        return None
    if any(_has_free_form(best, number, scores[0]) for number in range(len(best.fit.terms))):
        return None
    return with_data_driven_terms(problem, start)


def _has_free_form(state: SearchState, number: int, score: LawScore) -> bool:
    """Return whether a named term has a data-driven law's place and variable, and its effect has a free function.

    Such a law is the effect in a shape that its other laws lack: a drift to and fro is a drift.
    """
    term, form = state.fit.terms[number], data_driven_form(score.candidate.law)
    if not term.is_library_effect or not any(AMPLITUDE in one.constants for one in EFFECTS[term.slug].forms):
        return False
    joint = form.acts_on.joint
    moves = {(column.acts_on, column.index) for column in state.fit.term_columns(number)}
    own = all(one.joint in (None, joint) for one in form.inputs)
    return own and moves == {(form.acts_on.acts_on, joint)} and EFFECTS[term.slug].variables == form.variables


def without_imitations(problem: SearchProblem, state: SearchState) -> SearchState:
    """Turn names that more probably stand in for something unknown into unknown terms; return the new state.

    One cause is one unknown: a hose about a joint looks like lines, or a curve, of its angle. A name that mostly moves
    a joint by its angle loses its name beside an unknown term that does the same. So does a curve, or a series of
    lowest cycles, of one joint alone: gears err alike in several joints, a hose pulls at one. Of eight such names none
    was right (seeds 20261226, 20261227, 20261128).
    """
    fit, terms = state.fit, state.fit.terms
    unknown = {
        column.joint
        for number, term in enumerate(terms)
        if term.slug == UNKNOWN and not is_borrowed(term.law) and InputVariable.JOINT_ANGLE in term.law.form.variables
        for column in fit.term_columns(number)
    } - {None}
    for number, term in enumerate(terms):
        if term.slug == UNKNOWN or EFFECTS[term.slug].variables != {InputVariable.JOINT_ANGLE}:
            continue
        moved = [column.joint for column in fit.term_columns(number)]
        if not (
            share_of(fit, number, [joint in unknown for joint in moved]) > MOSTLY
            or (term.slug == TRANSMISSION_ERROR and len(set(moved)) == 1 and is_free_function(fit, number))
        ):
            continue
        effect = EFFECTS[term.slug]
        places = place_in_words(tuple(dict.fromkeys(column.where for column in fit.term_columns(number))))
        note = f"something moves {places} and looks like {effect.title}"
        law = borrowed("imitation", effect, term.law.form).law(term.law.constants, term.law.tried)
        terms = with_term(terms, number, replace(term, slug=UNKNOWN, law=law, note=note))
    return state if terms is fit.terms else problem.state(terms, state)


def _with_term(problem: SearchProblem, state: SearchState, scores: Sequence[LawScore]) -> SearchState | None:
    """Add the first data-driven term that holds; None if none does."""
    data, fit = state.data, state.fit
    score = next((one for one in scores if _holds(problem, state, one)), None)
    if score is None:
        return None
    law = score.candidate.law
    choices: list[ModelTerms] = [(*fit.terms, ModelTerm(UNKNOWN, law, score.names))]
    # The term is a general function of its variables in its place: named effects that described a part may go.
    where = score.candidate.columns[0].where
    others = tuple(term for term in fit.terms if not _acts_only_on(data, term, where))
    if len(others) < len(fit.terms):
        names = tuple(column.name for column in data.columns(UNKNOWN, law))
        choices.append((*others, ModelTerm(UNKNOWN, law, names)))
    steps = [problem.step(UNKNOWN, "a data-driven term added", score.value, terms) for terms in choices]
    return best_state([apply_step(state, step) for step in steps])


def _holds(problem: SearchProblem, state: SearchState, score: LawScore) -> bool:
    """Return whether a term explains a visible share of the residuals, also on left-out readings and beside discrepancy
    terms.

    The residual of a slightly wrong law often looks like a law of other variables.
    """
    return (
        _share_beyond_noise(state, score) > _LEAST_SHARE
        and cross_validated_gain(state.data, state.fit, score.rows) > 0.0
        and explains_beside_discrepancies(problem, state, score)
    )


def _share_beyond_noise(state: SearchState, score: LawScore) -> float:
    """Return the share of the remaining sum of squares beyond the noise that a term explains beyond chance.

    If no uncertainty is stated, the noise is unknown: the share is then that of all residuals.
    """
    remaining = scatter(state.data, state.fit)
    beyond_noise = 1.0 if remaining is None else 1.0 - min(remaining.ratio**-2, 1.0)
    beyond_chance = score.explained_share - len(score.chosen) / len(state.fit.residual)
    return beyond_chance / beyond_noise if beyond_noise > 0.0 else 0.0


def _best_scores(problem: SearchProblem, state: SearchState) -> list[LawScore]:
    """Return the best laws of two variables and of one that pass the threshold, the preferred one first."""
    context = state.data.context
    scan, every = DirectionScan.of(state.data, state.fit), acted_on(context.joints)
    one = _best_law(state, _Tried.of(state, scan, curve_families(context), every))
    of_angles = pair_families(context, own_angles(context))
    tried = _Tried.of(state, scan, of_angles, every)
    if one is not None:
        known = {family.inputs for family in of_angles}
        others = [family for family in pair_families(context) if family.inputs not in known]
        acts_on = data_driven_form(one.candidate.law).acts_on
        tried = tried.with_others(_Tried.of(state, scan, others, (acts_on,)))
    two = _best_law(state, tried)
    found = [score for score in (two, one) if score is not None and score.value > problem.threshold]
    if len(found) == 2 and found[0].value <= found[1].value + SCORE_MARGIN:
        return found[1:]
    return found


@dataclass(frozen=True, eq=False)
class _Tried:
    """Best laws of families in places, in decreasing order of score, and the number of laws tried."""

    best: tuple[tuple[float, FunctionFamily, ActedOn], ...]
    count: int

    @classmethod
    def of(
        cls, state: SearchState, scan: DirectionScan, families: Sequence[FunctionFamily], chosen: Sequence[ActedOn]
    ) -> _Tried:
        """Score the laws that the readings can determine, except those whose subject already has a term."""
        data, fit = state.data, state.fit
        taken = {
            data_driven_form(term.law).subject
            for term in fit.terms
            if term.slug == UNKNOWN and not is_borrowed(term.law)
        }
        evaluated = Families.of(data, families)
        possible = np.array(
            [[(acts_on.subject, family.inputs) not in taken for family in families] for acts_on in chosen], dtype=bool
        ).reshape(len(chosen), len(families))
        columns = np.array([max(len(acts_on.parts), 1) for acts_on in chosen])[:, None] * evaluated.sizes
        few = COORDINATES_EACH * (columns + fitted_parameters(fit)) <= 3 * len(data)
        values = np.where(possible & few, scan.scores(evaluated, chosen), -np.inf)
        order = np.argsort(-values, axis=None, kind="stable")[:_SELECTED]
        places = [divmod(int(place), len(families)) for place in order if np.isfinite(values.flat[place])]
        best = tuple((float(values[row, k]), families[k], chosen[row]) for row, k in places)
        return cls(best, int(np.count_nonzero(possible)))

    def with_others(self, others: _Tried) -> _Tried:
        """Merge both."""
        best = sorted((*self.best, *others.best), key=lambda one: -one[0])
        return _Tried(tuple(best[:_SELECTED]), self.count + others.count)


def _best_law(state: SearchState, tried: _Tried) -> LawScore | None:
    """Return the best of many data-driven laws without invisible columns, less the price of choosing."""
    data, fit = state.data, state.fit
    candidates = [fit.candidate(data, UNKNOWN, family.law(acts_on)) for _, family, acts_on in tried.best]
    ranked = LawScan.of(candidates, fit.projector).ranked(fit.projected_residual)
    if not ranked:
        return None
    best = _with_needed_functions(ranked[0], fit)
    return replace(best, value=best.value - 2.0 * math.log(max(tried.count, 1)))


def _with_needed_functions(score: LawScore, fit: JointFit) -> LawScore:
    """Keep only the functions that the criterion needs, if the score improves; choosing r of k costs 2 ln C(k, r).

    Dropping column j reduces the explained square by w_j^2 / (G^-1)_jj, with the solution w and the information G.
    """
    residual, rows, price = fit.projected_residual, score.rows, math.log(fit.projector.freedom)
    gram, moments = rows @ fit.projector.project(rows).T, rows @ residual.projected
    kept = np.arange(len(rows))
    remaining = residual.square * (1.0 - score.explained_share)
    while len(kept) > 1:
        inverse = np.linalg.pinv(gram[np.ix_(kept, kept)], rcond=VISIBLE**2, hermitian=True)
        losses = (inverse @ moments[kept]) ** 2 / np.maximum(np.diag(inverse), SMALLEST)
        least = int(np.argmin(losses))
        if residual.freedom * math.log1p(float(losses[least]) / remaining) > price:
            break
        remaining += float(losses[least])
        kept = np.delete(kept, least)
    choices = math.comb(len(rows), len(kept))
    value = residual.bic_gain(rows[kept]) - 2.0 * math.log(choices)
    if value <= score.value:
        return score
    candidate = replace(score.candidate, law=replace(score.candidate.law, tried=choices))
    chosen = tuple(score.chosen[k] for k in kept)
    return LawScore(candidate, value, chosen, residual.explained_share(rows[kept]))


def _acts_only_on(data: ArmData, term: ModelTerm, where: str) -> bool:
    """Return whether a named term acts only on the place ``where``."""
    if not term.is_library_effect:
        return False
    return {column.where for column in data.columns(term.slug, term.law, term.names)} == {where}
