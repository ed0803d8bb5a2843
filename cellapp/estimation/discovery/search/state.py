"""States of the search for missing effects: problem, current model, steps taken, review of the result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms, refit
from cellapp.estimation.discovery.records import RunnerUp
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.significance import corrected_p_value
from cellapp.estimation.discovery.terms import UNKNOWN, ModelTerm, ModelTerms
from cellapp.ground.memory import give_back
from cellapp.ground.progress import CancelToken
from cellapp.robot.effects import EFFECTS
from cellapp.robot.effects.contradiction import is_contradiction
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

SCORE_MARGIN = 10.0
"""Difference of scores that counts as very strong evidence (Kass, Raftery, J. Am. Stat. Ass. 90 (1995) 773: twice the
log Bayes factor above 10). Effects within it of an accepted one are its rivals; what is not in the library, and a more
complicated law, must lead by it."""


@dataclass(frozen=True)
class SearchStep:
    """A step of the search: effect, description, score, and the terms it leads to; the model once they are fitted."""

    slug: str
    what: str
    score: float
    p_value: float
    terms: ModelTerms
    model: ArmModel | None = None


@dataclass(frozen=True, eq=False)
class SearchState:
    """A model in the search, the steps that led to it, and the effects dropped on the way."""

    data: ArmData
    fit: JointFit
    steps: tuple[SearchStep, ...] = ()
    dropped: tuple[str, ...] = ()

    @property
    def slugs(self) -> set[str]:
        """Effects in the model."""
        return {term.slug for term in self.fit.terms}

    def scan(self, slugs: Sequence[str]) -> LawScan:
        """Scan of all laws of some effects beside the model; the last one is kept until it is given up."""
        key = (LawScan, tuple(slugs))
        if key not in self.fit.derived:
            self.give_up_scan()
            self.fit.derived[key] = LawScan.of(self.fit.candidates(self.data, slugs), self.fit.projector)
        found: LawScan = self.fit.derived[key]
        return found

    def give_up_scan(self) -> None:
        """Free the memory of ``scan``, tens of megabytes."""
        for key in [key for key, kept in self.fit.derived.items() if isinstance(kept, LawScan)]:
            del self.fit.derived[key]
        give_back()


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """What does not change during a search.

    Attributes
    ----------
    data : ArmData
        With the weights that the readings state.
    slugs : tuple of str
        Effects of the library to look for.
    null_maxima : array
        Largest scores of simulated data with nothing missing.
    threshold : float
        Score that an effect must pass.
    cancel : CancelToken
    say : callable
        Takes what the search does now, in a few words.
    """

    data: ArmData
    slugs: tuple[str, ...]
    null_maxima: Array
    threshold: float
    cancel: CancelToken
    say: Callable[[str], None]

    def p_value(self, score: float) -> float:
        """Probability of a score at least this large where nothing is missing, corrected for the whole scan."""
        return corrected_p_value(self.null_maxima, score)

    def state(self, terms: ModelTerms, near: SearchState) -> SearchState:
        """The fitted state of some terms, from the values of a state nearby and with its history."""
        return SearchState(*refit(near.data.at(near.fit.model), terms), near.steps, near.dropped)

    def step(self, slug: str, what: str, score: float, terms: ModelTerms) -> SearchStep:
        """A step with its p-value."""
        return SearchStep(slug, what, score, self.p_value(score), terms)


@dataclass(frozen=True)
class Review:
    """Score of an accepted term beside all others, and the effects that could take its place.

    ``alternatives`` are the scores of all effects in its place, with physically possible values, by slug.
    """

    term: ModelTerm
    score: float
    p_value: float
    rivals: tuple[RunnerUp, ...]
    alternatives: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Posteriors:
    """Probability that each term's effect is there, in their order, and that of every effect that was tested."""

    terms: tuple[float, ...]
    effects: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The outcome of a search.

    Attributes
    ----------
    data, fit
        The final model on the readings that were searched.
    geometry_only : JointFit
        The fit before the search.
    reviews : tuple of Review
        One for each term of ``fit``.
    steps, dropped
        Steps of the search, and effects that it added and dropped again.
    threshold : float
        Score that an effect had to pass.
    improbable : mapping
        Effects that were found but dropped, as they are more probably not there than there, with their probabilities.
    posteriors : Posteriors or None
        The probabilities; None of another fit than that in which the search ended.
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

    @property
    def absent(self) -> list[str]:
        """Effects of the library that the final model does not have."""
        taken = {term.slug for term in self.fit.terms}
        return [slug for slug in EFFECTS if slug not in taken and slug != UNKNOWN]

    def with_fit(self, data: ArmData, fit: JointFit, reviews: tuple[Review, ...]) -> SearchResult:
        """This result with another fit of the final model."""
        return replace(self, data=data, fit=fit, reviews=reviews, posteriors=None)

    def without_terms(self) -> SearchResult:
        """This result with the geometry alone: everything that was added counts as dropped."""
        dropped = (*self.dropped, *(term.slug for term in self.fit.terms))
        # the search, and its fit of the geometry, may have seen a part of the readings
        bare = fit_terms(self.data, ())
        return replace(self.with_fit(self.data, bare, ()), geometry_only=bare, dropped=dropped)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """What the readings look like where a law of the library holds with impossible values only."""
        return tuple(term.note for term in self.fit.terms if is_contradiction(term.law))
