"""Stepwise search for the effects that a calibrated model lacks.

1. Add effects of the library while one passes the threshold. Refine the law of an effect before a second is named.
2. If the named effects leave more than the noise, extend the model beyond the library: by data-driven terms or free
   curves of the joints. Try these beside the named effects and, unless the names explain nearly all, in their place.
3. Review each model, take the best by the Bayesian information criterion, and find the rivals of its terms.
4. Drop a named effect that is more probably absent than present, and search again without it. Withdraw the name of
   a term that is more probably a part of something unknown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.candidates import LawScore
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms, reweighted
from cellapp.estimation.discovery.posterior import posteriors_of, remaining_scan
from cellapp.estimation.discovery.search.addition import addition
from cellapp.estimation.discovery.search.comparison import best_state, criterion, floor_reached, scatter
from cellapp.estimation.discovery.search.contradiction import with_contradiction
from cellapp.estimation.discovery.search.data_driven import (
    in_place_of_names,
    with_data_driven_terms,
    without_imitations,
)
from cellapp.estimation.discovery.search.free_part import (
    may_be_left_by_a_look_alike,
    with_free_parts,
    without_free_parts,
)
from cellapp.estimation.discovery.search.refinement import refinement
from cellapp.estimation.discovery.search.review import review, reviewed
from cellapp.estimation.discovery.search.significance import score_threshold, simulate_null_maxima
from cellapp.estimation.discovery.search.smooth_terms import with_one_drift, with_smooth_terms
from cellapp.estimation.discovery.search.state import (
    SCORE_MARGIN,
    Posteriors,
    SearchProblem,
    SearchResult,
    SearchState,
    SearchStep,
)
from cellapp.estimation.discovery.search.tuning import apply_step
from cellapp.estimation.discovery.terms import UNKNOWN, has_smooth_terms, without_term
from cellapp.ground.counting import counted
from cellapp.ground.progress import CancelToken, Report, ignore_report
from cellapp.robot.effects import EFFECTS

_MOST_EFFECTS = 5
"""Most effects of the library in one model: further ones would only explain the imperfection of the other laws."""
_MOST_STEPS = 16
"""Most additions and refinements: three for each of the effects, and one more."""
LEAST_FREEDOM = 30.0
"""Least measured coordinates beyond the determined parameters for a search: any law fits the residuals of fewer."""
_EVEN_ODDS = 0.5
"""Least probability at which a name, or an answer set of names, is accepted."""
_FAR = 3.0
"""Scatter over the stated noise from which free functions are tried before laws with impossible values."""
_NULL_SEED = 0xD15C
"""Combined with the profile's seed, so that the simulated noise is independent of all other draws."""


SEARCH_STEPS = 4
"""Number of steps that a search reports: simulations without effects, library effects, beyond the library, review."""


def search(data: ArmData, slugs: Sequence[str], cancel: CancelToken, report: Report = ignore_report) -> SearchResult:
    """Search for effects among ``slugs`` and then for what no effect of the library explains.

    ``report`` takes the number of steps done, of ``SEARCH_STEPS``.
    """
    progress = _SearchProgress(report)
    settings = data.profile.discovery
    weighed, _ = reweighted(data, ())
    fit = fit_terms(weighed, ())
    start = SearchState(weighed.at(fit.model), fit)
    if len(fit.residual) - fit.projector.effective_parameters < LEAST_FREEDOM:
        slugs = ()
    seed = (data.profile.seed, _NULL_SEED)
    null_maxima = simulate_null_maxima(start.scan(slugs), fit.projector, settings.null_simulations, seed)
    threshold = score_threshold(null_maxima, settings.false_alarm)
    problem = SearchProblem(data, tuple(slugs), null_maxima, threshold, cancel, progress.say)
    progress.step("effects of the library")
    best = _best_model(problem, start, progress)
    progress.finish("review and rivals")
    found = _probable(problem, _result(problem, best, fit), best)
    return replace(found, not_fitted=tuple(dict.fromkeys(problem.not_fitted)))


def _probability_of_answers(found: SearchResult, probable: Posteriors) -> list[tuple[float, bool]]:
    """Return the probability of each term's name and of the rivals that the data cannot distinguish from it, in order.

    The second value tells whether such a rival is more probable than the name.
    """
    answers = []
    for own, one in zip(probable.terms, found.reviews, strict=True):
        rivals = [probable.effects.get(rival.effect, 0.0) for rival in one.rivals if not rival.distinguishable]
        answers.append((own + sum(rivals), own < max(rivals, default=0.0)))
    return answers


def _result(problem: SearchProblem, state: SearchState, geometry_only: JointFit) -> SearchResult:
    """Build the outcome of a search from its last state, with the rivals of each term."""
    reviews = []
    for number, term in enumerate(state.fit.terms):
        problem.cancel.check()
        problem.say(f"rivals of effect {number + 1} of {len(state.fit.terms)}, {term.slug}")
        reviews.append(review(problem, state, number))
    return SearchResult(
        data=state.data,
        fit=state.fit,
        geometry_only=geometry_only,
        reviews=tuple(reviews),
        steps=state.steps,
        dropped=state.dropped,
        threshold=problem.threshold,
    )


def _probable(problem: SearchProblem, found: SearchResult, state: SearchState) -> SearchResult:
    """Drop the names that are more probably absent than present, the least probable first, and return the outcome.

    Rivals that the data cannot distinguish from a name form one answer set with it, and their probabilities add. A
    rival may take the place of a dropped name; the same test applies to it. A name gives way to a more probable rival
    if the search without the name ends in a model that is no worse. Otherwise the difference limits the score of any
    rival in its place.
    """
    while True:
        probable = posteriors_of(found, remaining_scan(found))
        doubtful = [
            (probability, number)
            for number, (probability, led) in enumerate(_probability_of_answers(found, probable))
            if state.fit.terms[number].slug != UNKNOWN and (led or probability < _EVEN_ODDS)
        ]
        reviews = list(found.reviews)
        for probability, number in sorted(doubtful):
            state.give_up_scan()
            without, rest = _searched_without(problem, state, number)
            worse = criterion(rest.fit) - criterion(state.fit)
            if probability < _EVEN_ODDS or worse <= 0.0:
                break
            most = reviews[number].score - worse
            alternatives = {slug: min(score, most) for slug, score in reviews[number].alternatives.items()}
            reviews[number] = replace(reviews[number], alternatives=alternatives)
        else:
            found = replace(found, reviews=tuple(reviews))
            if doubtful:
                probable = posteriors_of(found, remaining_scan(found))
                left = [probability for probability, _ in _probability_of_answers(found, probable)]
                if any(left[number] < _EVEN_ODDS for _, number in doubtful):
                    continue  # with its rivals limited it is improbable by itself
            unnamed = without_imitations(problem, state)
            if unnamed is not state:
                found = replace(_result(problem, unnamed, found.geometry_only), improbable=found.improbable)
                probable = posteriors_of(found, remaining_scan(found))
            return replace(found, posteriors=probable)
        improbable = {**found.improbable, state.fit.terms[number].slug: probability}
        problem, state = without, rest
        found = replace(_result(problem, state, found.geometry_only), improbable=improbable)


def _searched_without(problem: SearchProblem, state: SearchState, number: int) -> tuple[SearchProblem, SearchState]:
    """Search again without the effect of a term; return the reduced problem and the last state."""
    slug = state.fit.terms[number].slug
    problem = replace(problem, slugs=tuple(one for one in problem.slugs if one != slug))
    # free parts were fitted beside the dropped term, and may hold the effect that takes its place
    rest = problem.state(without_free_parts(without_term(state.fit.terms, number)), state)
    rest = replace(rest, dropped=(*rest.dropped, slug))
    return problem, reviewed(problem, _with_library_effects(problem, rest))


@dataclass
class _SearchProgress:
    """Counter of the steps of a search that passes on messages; steps that are not needed are counted at the end."""

    report: Report
    done: int = 0

    def say(self, words: str) -> None:
        """Report a message within the current step."""
        self.report(self.done, words)

    def step(self, words: str) -> None:
        """Report that a step is done and that the next one begins."""
        self.done = min(self.done + 1, SEARCH_STEPS - 1)
        self.say(words)

    def finish(self, words: str) -> None:
        """Report that the last step begins."""
        self.done = SEARCH_STEPS - 1
        self.say(words)


def _best_model(problem: SearchProblem, start: SearchState, progress: _SearchProgress) -> SearchState:
    """Return the best reviewed model: named effects alone, extended by what the library lacks, or the reverse."""
    named = reviewed(problem, _with_library_effects(problem, start))
    progress.step("beyond the library")
    before_names = cache(partial(_smooth, problem, start))
    beaten = _far_from_floor(named) and _beats_all_names(problem, before_names(), named)
    if not beaten and not floor_reached(named):
        named = _with_contradictions(problem, start, named)
    drift = problem.tried("one drift", partial(with_one_drift, problem, named))
    named = named if drift is None else best_state([named, drift])  # one common cause is one unknown effect
    instead = problem.tried("a data-driven term", partial(in_place_of_names, problem, start, named))
    best = named if instead is None else best_state([named, reviewed(problem, instead)])
    if floor_reached(best):  # a law of few parameters explains all
        return best
    named.give_up_scan()
    free = _with_free_functions(problem, before_names(), named)
    if best_state([best, free]) is not best:
        best = free
    if floor_reached(best) and best is not free:  # a free function reaches the floor whatever the cause
        return best
    # if one unknown law replaces all names, names beside it would only share its signal
    bases = dict.fromkeys((best, named)) if best in (named, free) else (best,)
    leads = [(one, criterion(one.fit) - criterion(best.fit)) for one in bases]
    driven = [
        problem.tried("a data-driven term", partial(with_data_driven_terms, problem, *one_and_lead))
        for one_and_lead in leads
    ]
    return best_state([best, *(_reviewed_again(problem, state) for state in driven if state is not None)])


def _with_contradictions(problem: SearchProblem, start: SearchState, named: SearchState) -> SearchState:
    """Return the better of the named model and one with a law of impossible values, beside or before names."""
    for state in dict.fromkeys((named, start)):
        found = problem.tried("a law of impossible values", partial(with_contradiction, problem, state))
        if found is not None:
            return best_state([named, _reviewed_again(problem, found)])
    return named


def _far_from_floor(state: SearchState) -> bool:
    """Return whether the residuals are so far above the noise that one more law will hardly reach it."""
    left = scatter(state.data, state.fit)
    return left is None or left.ratio > _FAR


def _beats_all_names(problem: SearchProblem, free: SearchState | None, named: SearchState) -> bool:
    """Return whether free functions beat the names even if every law added all that it explains alone."""
    lead = -math.inf if free is None else criterion(named.fit) - criterion(free.fit)
    if lead <= 0.0:
        return False
    scores = named.scan(problem.slugs).best_of_each_effect(named.fit.projected_residual, least=0.0)
    return lead > sum(max(score.value, 0.0) for score in scores)


def _with_free_functions(problem: SearchProblem, first: SearchState | None, named: SearchState) -> SearchState:
    """Return the best model with smooth free functions, ``first`` before names, or beside them; else ``named``."""
    if first is not None:
        first = reviewed(problem, _with_library_effects(problem, first))
        if best_state([named, first]) is first:
            return first
    beside = _smooth(problem, named) if named.fit.terms else None
    return named if beside is None else best_state([named, reviewed(problem, beside)])


def _smooth(problem: SearchProblem, state: SearchState) -> SearchState | None:
    return problem.tried("smooth free functions", partial(with_smooth_terms, problem, state))


def _reviewed_again(problem: SearchProblem, state: SearchState) -> SearchState:
    """Add the library's effects that now pass, and review the model."""
    return reviewed(problem, _with_library_effects(problem, state))


def _with_library_effects(problem: SearchProblem, state: SearchState) -> SearchState:
    """Add and refine effects of the library while one passes."""
    refused: set[tuple[str, str]] = set()
    refining, freed = True, False
    for _ in range(_MOST_STEPS):
        problem.cancel.check()
        problem.say(f"model with {counted(len(state.fit.terms), 'effect')}")
        step = _next_step(problem, state, refused, refining=refining)
        if step is None or (not freed and may_be_left_by_a_look_alike(state, step)):
            free = None if freed else problem.tried("free parts of laws", partial(with_free_parts, problem, state))
            if free is not None:  # the free parts hold the errors of the laws: search once more
                state.give_up_scan()
                state, freed = free, True
                continue
            if step is None:
                break
        try:
            after = problem.tried(step.what, partial(apply_step, problem, state, step))
        except TooFewReadings:  # too few for the parameters of the step
            break
        if after is None and step.slug not in state.slugs:
            problem = replace(problem, slugs=tuple(slug for slug in problem.slugs if slug != step.slug))
            continue
        if after is None or (step.slug in state.slugs and best_state([after, state]) is state):
            refining = False  # the refinement was better only in the linear scan
            continue
        state.give_up_scan()
        state, freed = after, False
    return state


def _next_step(
    problem: SearchProblem,
    state: SearchState,
    refused: set[tuple[str, str]],
    *,
    refining: bool,
) -> SearchStep | None:
    """Return the best refinement of an effect in the model, else the best new effect that holds; None if none passes.

    Laws that do not hold join ``refused``.
    """
    fit = state.fit
    left = [slug for slug in problem.slugs if slug not in state.slugs]
    ranked = state.scan(left).ranked(fit.projected_residual, least=problem.threshold)
    scores = [score for score in ranked if score.key not in refused]
    # beside smooth functions laws are seldom off and their refinement is costly: try it last
    late = has_smooth_terms(fit.terms)
    if refining and not late:
        step = _refinement(problem, state, _needed_gain(problem, scores[0].value if scores else -math.inf))
        if step is not None:
            return step
    step = None if len(state.slugs) >= _MOST_EFFECTS else _next_addition(problem, state, scores, refused)
    if step is None and refining and late:
        step = _refinement(problem, state, _needed_gain(problem, -math.inf))
    return step


def _refinement(problem: SearchProblem, state: SearchState, needed: float) -> SearchStep | None:
    return problem.tried("refinements of the effects", partial(refinement, problem, state, needed))


def _next_addition(
    problem: SearchProblem, state: SearchState, scores: Sequence[LawScore], refused: set[tuple[str, str]]
) -> SearchStep | None:
    """Return the best new effect that holds, None if there is none; laws that do not hold join ``refused``."""
    for score in scores:
        if score.value <= problem.threshold:
            break
        if score.key in refused:
            continue
        step = problem.tried(f"{EFFECTS[score.slug].title} added", partial(addition, problem, state, score))
        if step is not None:
            return step
        refused.add(score.key)
    return None


def _needed_gain(problem: SearchProblem, best_new: float) -> float:
    """Return the gain that a refinement needs: about the score of the best new name, else a clear margin."""
    if best_new > problem.threshold:
        return max(best_new - SCORE_MARGIN, 0.0)
    return max(problem.threshold, SCORE_MARGIN)
