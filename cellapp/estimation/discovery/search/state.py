"""States of the search for missing effects: problem, current model, steps taken, review and result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit, refit
from cellapp.estimation.discovery.records import RunnerUp
from cellapp.estimation.discovery.search.scan import LawScan, corrected_p_value
from cellapp.estimation.discovery.terms import UNKNOWN, ModelTerm, ModelTerms
from cellapp.ground.errors import tried
from cellapp.ground.progress import CancelToken
from cellapp.ground.threads import give_back
from cellapp.robot.effects import EFFECTS
from cellapp.robot.effects.contradiction import is_contradiction
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

Found = TypeVar("Found")

SCORE_MARGIN = 10.0
"""Difference of scores that counts as very strong evidence (Kass, Raftery, J. Am. Stat. Ass. 90 (1995) 773: twice the
log Bayes factor above 10). Effects within this margin of an accepted one are its rivals. A law outside the library, and
a more complicated law, must lead by it."""


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
    cancel : CancelToken
    say : callable
        Callback for a short message on the current activity.
    not_fitted : list of str
        Candidates whose fit did not converge, in words: they were dropped without a judgement.
    """

    data: ArmData
    slugs: tuple[str, ...]
    null_maxima: Array
    threshold: float
    cancel: CancelToken
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
    """Score of an accepted term beside all others, and its rivals.

    ``alternatives`` maps the slug of every effect to its score in the term's place, with physically possible values.
    """

    term: ModelTerm
    score: float
    p_value: float
    rivals: tuple[RunnerUp, ...]
    alternatives: Mapping[str, float] = field(default_factory=dict)


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

    @property
    def absent(self) -> list[str]:
        """Effects of the library that the final model does not have."""
        taken = {term.slug for term in self.fit.terms}
        return [slug for slug in EFFECTS if slug not in taken and slug != UNKNOWN]

    def with_fit(self, data: ArmData, fit: JointFit, reviews: tuple[Review, ...]) -> SearchResult:
        """Return this result with another fit of the final model."""
        return replace(self, data=data, fit=fit, reviews=reviews, posteriors=None)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Descriptions of the terms by which a law of the library fits, but only with impossible values."""
        return tuple(term.note for term in self.fit.terms if is_contradiction(term.law))
