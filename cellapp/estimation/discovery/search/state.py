"""States of the search for missing effects: problem, current model, steps taken, review and result."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
import scipy

from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.calibration.quantities import states_nothing
from cellapp.estimation.design.information import visible_root
from cellapp.estimation.discovery.arm_data import (
    BOUND_ERRORS,
    UNKNOWN,
    ArmData,
    LawScore,
    ModelTerm,
    ModelTerms,
    blocks_beyond_bounds,
    whitening,
    with_term,
)
from cellapp.estimation.discovery.joint_fit import JointFit, ProjectedResidual, fit_terms, refit
from cellapp.estimation.discovery.records import RunnerUp
from cellapp.estimation.discovery.search.scan import LawScan, choice_price, corrected_p_value
from cellapp.ground.errors import tried
from cellapp.ground.progress import JobToken
from cellapp.ground.threads import give_back
from cellapp.robot.effects import EFFECTS, Law
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

Found = TypeVar("Found")

SCORE_MARGIN = 10.0
"""Difference of scores that counts as very strong evidence (Kass, Raftery, J. Am. Stat. Ass. 90 (1995) 773: twice the
log Bayes factor above 10). Effects within this margin of an accepted one are its alternatives. A law outside the
library, and a more complicated law, must lead by it."""


@dataclass(frozen=True)
class SearchStep:
    """A step of the search: effect, description, score, and the resulting terms; ``model`` once these are fitted."""

    slug: str
    what: str
    score: float
    p_value: float
    terms: ModelTerms
    model: ArmModel | None = None


@dataclass(frozen=True, eq=False)
class SearchState:
    """A model in the search, the steps to it, and the effects dropped on the way."""

    data: ArmData
    fit: JointFit
    steps: tuple[SearchStep, ...] = ()
    dropped: tuple[str, ...] = ()

    @property
    def slugs(self) -> set[str]:
        """Effects in the model."""
        return {term.slug for term in self.fit.terms}

    def scan(self, slugs: Sequence[str]) -> LawScan:
        """Scan all laws of some effects beside the model; the last scan is cached until ``give_up_scan``."""
        key = (LawScan, tuple(slugs))
        if key not in self.fit.derived:
            self.give_up_scan()
            self.fit.derived[key] = LawScan.of(self.fit.candidates(self.data, slugs), self.fit.projector)
        found: LawScan = self.fit.derived[key]
        return found

    def give_up_scan(self) -> None:
        """Discard the cached scan, tens of megabytes."""
        for key in [key for key, kept in self.fit.derived.items() if isinstance(kept, LawScan)]:
            del self.fit.derived[key]
        give_back()


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """The constants of a search.

    Attributes
    ----------
    data : ArmData
        The readings, with the weights that they state.
    slugs : tuple of str
        Effects of the library to look for.
    null_maxima : array
        Largest scores in simulated data without effects.
    threshold : float
        Score that an effect must pass.
    job : JobToken
    say : callable
        Callback for a short message on the current activity.
    not_fitted : list of str
        Candidates whose fit did not converge, in words: they were dropped without a judgement.
    """

    data: ArmData
    slugs: tuple[str, ...]
    null_maxima: Array
    threshold: float
    job: JobToken
    say: Callable[[str], None]
    not_fitted: list[str] = field(default_factory=list)

    def tried(self, what: str, candidate: Callable[[], Found | None]) -> Found | None:
        """Return what a ``candidate`` leads to; None, and ``what`` is noted, if a fit of it does not converge."""
        return tried(what, candidate, self.not_fitted)

    def p_value(self, score: float) -> float:
        """Return the probability of a score at least this large without effects, corrected for the whole scan."""
        return corrected_p_value(self.null_maxima, score)

    def state(self, terms: ModelTerms, near: SearchState) -> SearchState:
        """Fit some terms from the values of a nearby state; the new state keeps that state's history."""
        return SearchState(*refit(near.data.at(near.fit.model), terms), near.steps, near.dropped)

    def step(self, slug: str, what: str, score: float, terms: ModelTerms) -> SearchStep:
        """Return a step with its p-value."""
        return SearchStep(slug, what, score, self.p_value(score), terms)


@dataclass(frozen=True)
class Review:
    """Score of an accepted term beside all others, and its alternatives.

    ``alternative_scores`` maps the slug of every effect to its score in the term's place, physically possible.
    """

    term: ModelTerm
    score: float
    p_value: float
    alternatives: tuple[RunnerUp, ...]
    alternative_scores: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Posteriors:
    """Probability that each term's effect is present, in order, and that of every tested effect."""

    terms: tuple[float, ...]
    effects: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Outcome of a search.

    Attributes
    ----------
    data, fit
        The final model and the readings that were searched.
    geometry_only : JointFit
        The fit before the search.
    reviews : tuple of Review
        One for each term of ``fit``.
    steps, dropped
        Steps of the search, and effects that it added and dropped again.
    threshold : float
        Score that an effect had to pass.
    improbable : mapping
        Effects that were found but dropped as more probably absent than present, with their probabilities.
    posteriors : Posteriors or None
        The probabilities; None if ``fit`` is not the one in which the search ended.
    not_fitted : tuple of str
        Candidates whose fit did not converge, in words: nothing is known of them.
    unnamed_mm : pair of float, optional
        Mean error [mm] of left-out readings without and with the unnamed term, where one was tried.
    claim : float
        Factor of the stated uncertainty in ``data``: less than one if the readings scatter far less than they state.
    spread : float
        Factor of the predicted standard deviations by which 95 % of left-out readings are within their intervals.
    """

    data: ArmData
    fit: JointFit
    geometry_only: JointFit
    reviews: tuple[Review, ...]
    steps: tuple[SearchStep, ...]
    dropped: tuple[str, ...]
    threshold: float
    improbable: Mapping[str, float] = field(default_factory=dict)
    posteriors: Posteriors | None = None
    not_fitted: tuple[str, ...] = ()
    unnamed_mm: tuple[float, float] | None = None
    spread: float = 1.0
    claim: float = 1.0

    @property
    def state(self) -> SearchState:
        """The last state of the search."""
        return SearchState(self.data, self.fit, self.steps, self.dropped)

    @property
    def absent(self) -> list[str]:
        """Effects of the library that the final model does not have."""
        taken = {term.slug for term in self.fit.terms}
        return [slug for slug in EFFECTS if slug not in taken and slug != UNKNOWN]

    def with_fit(self, data: ArmData, fit: JointFit, reviews: tuple[Review, ...]) -> SearchResult:
        """Return this result with another fit of the final model."""
        return replace(self, data=data, fit=fit, reviews=reviews, posteriors=None)


# -- Comparison of fitted models: remaining scatter against the noise floor, and the Bayesian information criterion ---

FLOOR_CHANCE = 0.001
"""p-value of the remaining scatter above which it counts as noise; below, the search goes on."""


@dataclass(frozen=True)
class FitScatter:
    """Scatter of residuals relative to the stated uncertainty, or to the scatter found where that contradicts it.

    ``ratio`` is the root of chi-square per degree of freedom, ``p_value`` the probability of one at least as large.
    """

    ratio: float
    p_value: float
    against: str = "stated"


def scatter(data: ArmData, fit: JointFit) -> FitScatter | None:
    """Compute the scatter that a model leaves; None if the readings state no uncertainty."""
    if data.stated is None:
        return None
    squares = np.sum(np.einsum("acn,nc->an", whitening(data.stated), fit.identification.residuals) ** 2, axis=0)
    total, freedom = float(squares.sum()), 3.0 * len(data) - fit.projector.effective_parameters
    for kind in () if data.angular is None else (data.angular, ~data.angular):
        if states_nothing(data.stated[kind]):
            total -= float(squares[kind].sum())
            freedom -= 3.0 * np.count_nonzero(kind) - float(np.sum(fit.projector.basis[np.tile(kind, 3)] ** 2))
    if total <= 0.0:
        return None
    freedom = max(freedom, 1.0)
    return FitScatter(math.sqrt(total / freedom), float(scipy.special.chdtrc(freedom, total)))


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


# -- Removal of the blocks of a law whose values are physically impossible, by a linear estimate or a joint fit -------
#
# A negative stiffness at one joint is an alias of another cause there. It is no evidence against the effect at other
# joints.

NEARLY = 0.3
"""Relative change of a linearly estimated value that a joint fit may bring."""


def within_bounds(data: ArmData, others: ModelTerms, residual: ProjectedResidual, score: LawScore) -> LawScore | None:
    """Remove blocks whose values, fitted beside ``others``, are impossible; return the new score, or None."""

    def impossible(current: LawScore) -> set[str]:
        perhaps, surely = impossible_blocks(residual, current, NEARLY)
        if perhaps == surely:  # a joint fit would say the same
            return surely
        term = ModelTerm(current.slug, current.candidate.law, current.names)
        return fit_terms(data, (*others, term)).blocks_beyond_bounds(len(others))

    with_refinements = any(score.candidate.refines((place,)) for place in score.chosen)
    try:
        return _without_blocks(residual, score, impossible, with_refinements=with_refinements)
    except TooFewReadings:  # the readings do not determine all its columns
        return None


def possible_score(residual: ProjectedResidual, score: LawScore) -> float:
    """Return the score without blocks that need impossible values; minus infinity if no other block is left.

    Values are estimated linearly. A joint fit (``within_bounds``) is more exact at a hundred times the cost, too much
    for every alternative of every effect.
    """
    possible = _without_blocks(
        residual, score, lambda current: impossible_blocks(residual, current)[1], with_refinements=False
    )
    return -math.inf if possible is None else possible.value


def _without_blocks(
    residual: ProjectedResidual, score: LawScore, impossible: Callable[[LawScore], set[str]], *, with_refinements: bool
) -> LawScore | None:
    """Select a law's other blocks again until ``impossible`` names none; None if no block is left."""
    candidate, current = score.candidate, score
    remaining = list(range(len(candidate.columns)))
    while banned := impossible(current):
        remaining = [place for place in remaining if candidate.columns[place].block not in banned]
        if not remaining:
            return None
        scan = LawScan.of([candidate.keep(remaining)], residual.projector)
        again = scan.score(0, residual, with_refinements=with_refinements)
        if again is None:
            return None
        chosen = tuple(remaining[place] for place in again.chosen)
        current = replace(again, candidate=candidate, chosen=chosen)
    return current


def impossible_blocks(residual: ProjectedResidual, score: LawScore, nearly: float = 0.0) -> tuple[set[str], set[str]]:
    """Find blocks with a linearly estimated value outside its bounds by more than chance allows.

    Return those that may be outside if values change by a share ``nearly`` and their errors, and those that surely are.
    """
    columns = [score.candidate.columns[place] for place in score.chosen]
    if all(math.isinf(column.lower) and math.isinf(column.upper) for column in columns):
        return set(), set()
    root, _ = visible_root(score.rows @ residual.projector.project(score.rows).T, np.linalg.norm(score.rows, axis=1))
    values, errors = root @ (root.T @ (score.rows @ residual.projected)), np.linalg.norm(root, axis=1)
    change = nearly * np.abs(values) + (BOUND_ERRORS * errors if nearly else 0.0)
    more, less = (blocks_beyond_bounds(columns, values + sign * change, errors) for sign in (1.0, -1.0))
    return more | less, more & less


# -- Tuning of the non-linear constants of accepted laws (onset, time constant, knee, width) --------------------------
#
# Coordinate search: each constant moves to a nearby value if the term then explains more of the residual beside all
# other terms; the step shrinks from round to round.

_SHRINKAGE = (1.0, 1.0, 0.5, 0.5, 0.25, 0.12)
"""Factors on the step in each round, 0.3 in the logarithm of a constant: down to 4 %, finer than data determine a time
constant."""
_LEAST_IMPROVEMENT = 1e-9
"""Relative gain below which two values of a constant count as equal; above rounding errors."""


def apply_step(state: SearchState, step: SearchStep) -> SearchState:
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
