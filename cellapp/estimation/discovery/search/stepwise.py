"""Stepwise search for the effects that a calibrated model lacks.

1. Add effects of the library while one passes the threshold. Refine the law of an effect before a second is named.
2. If the named effects leave more than the noise, extend the model beyond the library: by data-driven terms or free
   curves of the joints. Try these beside the named effects and, unless the names explain nearly all, in their place.
3. Review each model, take the best by the Bayesian information criterion, and find the alternatives of its terms.
4. Drop a named effect that is more probably absent than present, and search again without it. Withdraw the name of
   a term that is more probably a part of something unknown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.calibration.least_squares import mean_variance
from cellapp.estimation.calibration.quantities import states_nothing
from cellapp.estimation.discovery.arm_data import (
    UNKNOWN,
    ArmData,
    CandidateLaw,
    LawScore,
    ModelTerm,
    has_smooth_terms,
    smoothness_of,
    with_term,
    without_term,
)
from cellapp.estimation.discovery.joint_fit import (
    JointFit,
    cross_validated_gain,
    fit_terms,
    refit,
    reweighted,
    uncertainty_with_scatter,
)
from cellapp.estimation.discovery.posterior import posteriors_of, remaining_scan
from cellapp.estimation.discovery.process import Component, components, fit_process, process_terms
from cellapp.estimation.discovery.search.data_driven import (
    in_place_of_names,
    with_data_driven_terms,
    without_imitations,
)
from cellapp.estimation.discovery.search.discrepancy_term import (
    are_confounded,
    explains_beside_discrepancies,
    may_stand_for_confounded,
    with_discrepancies,
    without_discrepancies,
)
from cellapp.estimation.discovery.search.review import review, reviewed, term_score, with_contradiction
from cellapp.estimation.discovery.search.scan import LawScan, score_threshold, simulate_null_maxima
from cellapp.estimation.discovery.search.state import (
    SCORE_MARGIN,
    Posteriors,
    SearchProblem,
    SearchResult,
    SearchState,
    SearchStep,
    apply_step,
    best_state,
    criterion,
    floor_reached,
    scatter,
    within_bounds,
)
from cellapp.estimation.discovery.search.unnamed_term import smooth_numbers, with_unnamed, without_names
from cellapp.ground.counting import counted
from cellapp.ground.progress import JobSteps
from cellapp.robot.effects import EFFECTS, ActsOn, InputVariable
from cellapp.robot.effects.base_motion import BaseDrift
from cellapp.robot.effects.periodic import LINES
from cellapp.robot.effects.thermal import JointDrift

# -- Addition of a library effect: the best law that passes threshold, physical bounds and cross-validation -----------

_REMAINDER = 0.1
"""Share (rms) of an effect that its law may leave as a residual, which may look like another effect: laws are taken to
hold to 10 %."""

_OTHER_WAY = 0.1
"""Least share of the square explained by a wobble that its second direction must hold."""
_SAME_DIRECTION = 0.995
"""Cosine from which two columns count as the same motion: neighbouring axes of real arms meet to a few mrad."""


def addition(problem: SearchProblem, state: SearchState, score: LawScore) -> SearchStep | None:
    """Return the step that adds the law of ``score``; None if the law does not hold."""
    residual = state.fit.projected_residual
    possible = within_bounds(state.data, state.fit.terms, residual, score)
    if possible is None or possible.value <= problem.threshold or _is_remainder(state, possible):
        return None
    if _acts_as_one_joint(state, possible):
        return None
    if not explains_beside_discrepancies(problem, state, possible):
        return None
    if cross_validated_gain(state.data, state.fit, possible.rows) <= 0.0:
        return None
    term = ModelTerm(possible.slug, possible.candidate.law, possible.names)
    title = EFFECTS[possible.slug].title
    return problem.step(possible.slug, f"{title} added", possible.value, (*state.fit.terms, term))


def _is_remainder(state: SearchState, score: LawScore) -> bool:
    """Return whether a law probably explains only the imperfection of the law of a far larger confounded effect."""
    if not floor_reached(state):
        return False
    fit = state.fit
    explained = score.explained_share * fit.projected_residual.square
    return any(
        explained < _REMAINDER**2 * fit.removed_square(number)
        for number, term in enumerate(fit.terms)
        if term.effect is not None and are_confounded(score.slug, term.effect.slug)
    )


def _acts_as_one_joint(state: SearchState, score: LawScore) -> bool:
    """Return whether a wobble tilts an axis in one direction only, which is just an offset of a neighbouring joint.

    The axis of a joint tilts about the axis of the preceding joint when that joint has an offset. Bearings tilt an axis
    in both directions. A tilt in one direction only is an error of that joint that depends on its neighbour's angle.
    """
    rows = score.rows
    axial = [column.acts_on is ActsOn.AXIS and column.wave is not None for column in score.candidate.columns]
    if not all(axial[place] for place in score.chosen):
        return False
    imitated = np.array([_is_joint_offset(state, score, k) for k in range(len(rows))])
    if not imitated.any():
        return False
    residual = state.fit.projected_residual
    return residual.explained(rows) - residual.explained(rows[imitated]) < _OTHER_WAY * residual.explained(rows)


def _is_joint_offset(state: SearchState, score: LawScore, place: int) -> bool:
    """Return whether a chosen column is the offset of some joint by the same wave."""
    column, row = score.candidate.columns[score.chosen[place]], score.rows[place]
    if column.wave is None or column.index is None:
        return False
    along = column.wave(state.data.readings.q[:, column.index])
    offsets = (state.fit.by_joint * along).swapaxes(0, 1).reshape(len(state.fit.by_joint[0]), -1)
    cosines = offsets @ row / np.maximum(np.linalg.norm(offsets, axis=1) * np.linalg.norm(row), 1e-300)
    return bool(np.max(np.abs(cosines)) > _SAME_DIRECTION)


_MOST_EFFECTS = 5
"""Most effects of the library in one model: further ones would only explain the imperfection of the other laws."""
_MOST_STEPS = 16
"""Most additions and refinements: three for each of the effects, and one more."""
LEAST_FREEDOM = 30.0
"""Least measured coordinates beyond the determined parameters for a search: any law fits the residuals of fewer."""
_EVEN_ODDS = 0.5
"""Least probability at which a name, or a set of confounded names, is accepted."""
_CONTRADICTED = 0.7
"""Ratio of scatter to stated uncertainty below which readings contradict what they state: the ratio is known to a few
percent, and a standard uncertainty that is stated half as large again is a usual caution."""
_FAR = 3.0
"""Scatter over the stated noise from which free functions are tried before laws with impossible values."""
_CLEARLY = 1.1
"""Lead of free functions, relative to all scores of names, that ends their search: a true law scores as much as a free
function to a few percent."""
_NULL_SEED = 0xD15C
"""Combined with the profile's seed, so that the simulated noise is independent of all other samples."""


SEARCH_STEPS = 4
"""Number of steps that a search reports: simulations without effects, library effects, beyond the library, review."""


def search(data: ArmData, slugs: Sequence[str], steps: JobSteps) -> SearchResult:
    """Search for effects among ``slugs`` and then for what no effect of the library explains.

    There are ``SEARCH_STEPS`` steps.
    """
    progress = _SearchProgress(steps)
    settings = data.profile.discovery
    weighed, _ = reweighted(data, ())
    fit = fit_terms(weighed, ())
    start = SearchState(weighed.at(fit.model), fit)
    if len(fit.residual) - fit.projector.effective_parameters < LEAST_FREEDOM:
        slugs = ()
    seed = (data.profile.seed, _NULL_SEED)
    null_maxima = simulate_null_maxima(start.scan(slugs), fit.projector, settings.null_simulations, seed)
    threshold = score_threshold(null_maxima, settings.false_alarm)
    problem = SearchProblem(data, tuple(slugs), null_maxima, threshold, steps.job, progress.say)
    progress.step("effects of the library")
    before_names = _smooth(problem, start)
    claim = _claim(data, start, before_names)
    if claim < _CONTRADICTED:  # weights and noise floor of what is stated would hide what is missing
        return replace(search(data.claiming(claim), slugs, steps), claim=claim)
    best = _best_model(problem, start, before_names, progress)
    progress.finish("review and alternatives")
    found = _probable(problem, _result(problem, best, fit), best)
    extended = _smooth(problem, found.state) if found.fit.terms or not before_names else before_names
    found = with_unnamed(problem, found, extended)
    if len(found.reviews) < len(found.fit.terms):
        added = range(len(found.reviews), len(found.fit.terms))
        found = replace(found, reviews=(*found.reviews, *(review(problem, found.state, number) for number in added)))
    return replace(found, not_fitted=tuple(dict.fromkeys(problem.not_fitted)))


def _claim(data: ArmData, start: SearchState, before_names: SearchState | None) -> float:
    """Return the ratio of the scatter of positions to what they state, about free functions; 1 if nothing is stated."""
    points = data.points
    if data.stated is None or states_nothing(data.stated[points]):
        return 1.0
    about_geometry = scatter(data, start.fit)
    ratios = [1.0] if about_geometry is None else [about_geometry.ratio]
    smooth = None if before_names is None else smoothness_of(before_names.fit.terms)
    if smooth is not None:
        found = mean_variance(uncertainty_with_scatter(data, smooth.scatter)[points])
        ratios.append(math.sqrt(found / mean_variance(data.stated[points])))
    return min(ratios)


def _probabilities_of_sets(found: SearchResult, probable: Posteriors) -> list[tuple[float, bool]]:
    """Return the probability of each term's name and of the alternatives that the data cannot distinguish from it, in
    order.

    The second value tells whether such an alternative is more probable than the name.
    """
    sets = []
    for own, one in zip(probable.terms, found.reviews, strict=True):
        likely = [probable.effects.get(other.effect, 0.0) for other in one.alternatives if not other.distinguishable]
        sets.append((own + sum(likely), own < max(likely, default=0.0)))
    return sets


def _result(problem: SearchProblem, state: SearchState, geometry_only: JointFit) -> SearchResult:
    """Build the outcome of a search from its last state, with the alternatives of each term."""
    reviews = []
    for number, term in enumerate(state.fit.terms):
        problem.job.check()
        problem.say(f"alternatives of effect {number + 1} of {len(state.fit.terms)}, {term.slug}")
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

    Alternatives that the data cannot distinguish from a name form one set of alternatives with it, and their
    probabilities add. An alternative may take the place of a dropped name; the same test applies to it. A name gives
    way to a more probable alternative if the search without the name ends in a model that is no worse. Otherwise the
    difference limits the score of any alternative in its place. A free function beside a law of the same effect has no
    name: it says where that law falls short, not what else is there.
    """
    while True:
        probable = posteriors_of(found, remaining_scan(found))
        sets = _probabilities_of_sets(found, probable)
        nameless, improbable = _without_probable_names(state.fit.terms, sets)
        if nameless:
            state = replace(state, fit=without_names(state.fit, nameless))
            found = replace(_result(problem, state, found.geometry_only), improbable={**found.improbable, **improbable})
            continue
        unlikely = [
            (probability, number)
            for number, (probability, led) in enumerate(sets)
            if state.fit.terms[number].slug != UNKNOWN and (led or probability < _EVEN_ODDS)
        ]
        reviews = list(found.reviews)
        for probability, number in sorted(unlikely):
            state.give_up_scan()
            without, rest = _searched_without(problem, state, number)
            worse = criterion(rest.fit) - criterion(state.fit)
            if probability < _EVEN_ODDS or worse <= 0.0:
                break
            most = reviews[number].score - worse
            limited = {slug: min(score, most) for slug, score in reviews[number].alternative_scores.items()}
            reviews[number] = replace(reviews[number], alternative_scores=limited)
        else:
            found = replace(found, reviews=tuple(reviews))
            if unlikely:
                probable = posteriors_of(found, remaining_scan(found))
                others = [probability for probability, _ in _probabilities_of_sets(found, probable)]
                if any(others[number] < _EVEN_ODDS for _, number in unlikely):
                    continue  # with its alternatives limited it is improbable by itself
            unnamed = without_imitations(problem, state)
            if unnamed is not state:
                found = replace(_result(problem, unnamed, found.geometry_only), improbable=found.improbable)
                probable = posteriors_of(found, remaining_scan(found))
            return replace(found, posteriors=probable)
        improbable = {**found.improbable, state.fit.terms[number].slug: probability}
        problem, state = without, rest
        found = replace(_result(problem, state, found.geometry_only), improbable=improbable)


def _without_probable_names(
    terms: Sequence[ModelTerm], sets: Sequence[tuple[float, bool]]
) -> tuple[list[int], dict[str, float]]:
    """Return the numbers of the smooth terms that lose their names, and the probabilities of improbable names."""
    by_law = {term.slug for term in terms if term.smooth is None}
    numbers, improbable = [], {}
    for number in smooth_numbers(terms):
        slug, (probability, led) = terms[number].slug, sets[number]
        if slug not in by_law:
            if probability >= _EVEN_ODDS and not led:
                continue
            improbable[slug] = probability
        numbers.append(number)
    return numbers, improbable


def _searched_without(problem: SearchProblem, state: SearchState, number: int) -> tuple[SearchProblem, SearchState]:
    """Search again without the effect of a term; return the reduced problem and the last state."""
    slug = state.fit.terms[number].slug
    problem = replace(problem, slugs=tuple(one for one in problem.slugs if one != slug))
    # discrepancy terms were fitted beside the dropped term, and may hold the effect that takes its place
    rest = problem.state(without_discrepancies(without_term(state.fit.terms, number)), state)
    rest = replace(rest, dropped=(*rest.dropped, slug))
    return problem, reviewed(problem, _with_library_effects(problem, rest))


@dataclass
class _SearchProgress:
    """Counter of the steps of a search that passes on messages; steps that are not needed are counted at the end."""

    steps: JobSteps
    done: int = 0

    def say(self, words: str) -> None:
        """Report a message within the current step."""
        self.steps(self.done, words)

    def step(self, words: str) -> None:
        """Report that a step is done and that the next one begins."""
        self.done = min(self.done + 1, SEARCH_STEPS - 1)
        self.say(words)

    def finish(self, words: str) -> None:
        """Report that the last step begins."""
        self.done = SEARCH_STEPS - 1
        self.say(words)


def _best_model(
    problem: SearchProblem, start: SearchState, before_names: SearchState | None, progress: _SearchProgress
) -> SearchState:
    """Return the best reviewed model: named effects alone, extended by what the library lacks, or the reverse.

    ``before_names`` has free functions alone.
    """
    named = reviewed(problem, _with_library_effects(problem, start, before_names))
    progress.step("beyond the library")
    if before_names is not None and _beats_all_names(problem, before_names, named):
        best = best_state([named, _reviewed_again(problem, before_names)])
        lead = criterion(start.fit) - criterion(best.fit)  # they imitate one law that the library lacks, too
        instead = problem.tried("a data-driven term", partial(with_data_driven_terms, problem, start, lead, most=1))
        return best if instead is None else best_state([best, _reviewed_again(problem, instead)])
    if not floor_reached(named):
        named = _with_contradictions(problem, start, named)
    drift = problem.tried("one drift", partial(with_one_drift, problem, named))
    named = named if drift is None else best_state([named, drift])  # one common cause is one unknown effect
    instead = problem.tried("a data-driven term", partial(in_place_of_names, problem, start, named))
    best = named if instead is None else best_state([named, reviewed(problem, instead)])
    if floor_reached(best):  # a law of few parameters explains all
        return best
    named.give_up_scan()
    free = _with_free_functions(problem, before_names, named)
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
    others = scatter(state.data, state.fit)
    return others is None or others.ratio > _FAR


def _beats_all_names(problem: SearchProblem, free: SearchState | None, named: SearchState, factor: float = 1.0) -> bool:
    """Return whether free functions beat the names even if every law added all that it explains alone."""
    lead = -math.inf if free is None or not _far_from_floor(named) else criterion(named.fit) - criterion(free.fit)
    if lead <= 0.0:
        return False
    key = (_beats_all_names, problem.slugs)
    if key not in named.fit.derived:  # asked once in the search for names, and once after it
        scores = named.scan(problem.slugs).best_of_each_effect(named.fit.projected_residual, least=0.0)
        named.fit.derived[key] = sum(max(score.value, 0.0) for score in scores)
    return bool(lead > factor * named.fit.derived[key])


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


def _with_library_effects(
    problem: SearchProblem, state: SearchState, before_names: SearchState | None = None
) -> SearchState:
    """Add and refine effects of the library while one passes, and free functions, ``before_names``, do not beat all."""
    refused: set[tuple[str, str]] = set()
    refining, freed = True, False
    for _ in range(_MOST_STEPS):
        problem.job.check()
        problem.say(f"model with {counted(len(state.fit.terms), 'effect')}")
        if _beats_all_names(problem, before_names, state, _CLEARLY):
            break
        step = _next_step(problem, state, refused, refining=refining)
        if step is None or (not freed and may_stand_for_confounded(state, step)):
            free = None if freed else problem.tried("discrepancy terms", partial(with_discrepancies, problem, state))
            if free is not None:  # these hold the errors of the laws: search once more
                state.give_up_scan()
                state, freed = free, True
                continue
            if step is None:
                break
        try:
            after = problem.tried(step.what, partial(apply_step, state, step))
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
    problem: SearchProblem, state: SearchState, refused: set[tuple[str, str]], *, refining: bool
) -> SearchStep | None:
    """Return the best refinement of an effect in the model, else the best new effect that holds; None if none passes.

    Laws that do not hold join ``refused``.
    """
    fit = state.fit
    others = [slug for slug in problem.slugs if slug not in state.slugs]
    ranked = state.scan(others).ranked(fit.projected_residual, least=problem.threshold)
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


# ---------------------------------------------------------------------------------------------------------------------
# Smooth free functions beside, or in place of, the effects found: the structured process as a step of the search.


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
        term.is_library_effect and InputVariable.TIME in EFFECTS[term.slug].variables for term in state.fit.terms
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
    data = state.data.at(state.fit.model)
    data, fit = refit(replace(data, start={**data.start, **found[0].expected()}), terms)
    steps = list(state.steps)
    for number in range(len(state.fit.terms), len(terms)):
        term = fit.terms[number]
        assert term.smooth is not None
        what = f"{EFFECTS[term.slug].title}: {term.law.form.words}"
        steps.append(problem.step(term.slug, what, term.smooth.evidence, terms[: number + 1]))
    steps[-1] = replace(steps[-1], model=fit.model)
    return SearchState(data, fit, tuple(steps), state.dropped)


# -- Refinement of an effect in the model: another law of it, or further joints ---------------------------------------
#
# The law of the first effect is refined before a second one is named, as the residual of an imperfect law can look like
# another effect.


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
        if term.is_library_effect:
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
    """Return a step to one more joint or refining column beside all that a term has, its discrepancy term included;
    else None.

    Selecting the whole law again would omit the discrepancy term, and its residual hides small blocks.
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
