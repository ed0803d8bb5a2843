"""Discovery for a calibrated cell: search every arm, judge on held-out readings, add the effects found to the model."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.calibration.calibrate import (
    ROUNDS,
    gross_errors_of_geometry,
    gross_errors_of_model,
    left_out_words,
    network_of_residuals,
    rms_length_mm,
    rotation_network,
    without,
)
from cellapp.estimation.calibration.least_squares import mean_variance
from cellapp.estimation.calibration.network_training import learning_steps
from cellapp.estimation.calibration.pair_calibration import calibrate_pair
from cellapp.estimation.calibration.quantities import ArmReadings, states_nothing
from cellapp.estimation.discovery.accepted import accepted_effects, pictures
from cellapp.estimation.discovery.all_readings import fit_terms_to_all, fit_to_all
from cellapp.estimation.discovery.arm_data import UNKNOWN, ArmData, smoothness_of
from cellapp.estimation.discovery.joint_fit import noise_of, with_posterior
from cellapp.estimation.discovery.outcome import ArmFound, CellDiscovery, HeldOut
from cellapp.estimation.discovery.plan_forecast import detectability
from cellapp.estimation.discovery.posterior import posteriors_of, remaining_scan
from cellapp.estimation.discovery.records import ArmDiscoveryResult, BeforeAfter, GapStep, HeldOutBeforeAfter, Noise
from cellapp.estimation.discovery.search.state import SCORE_MARGIN, SearchResult, scatter
from cellapp.estimation.discovery.search.stepwise import SEARCH_STEPS, search
from cellapp.estimation.discovery.search.unnamed_term import unnamed_record
from cellapp.estimation.discovery.verdict import residual_structure, verdict
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.readings import one_a_stop
from cellapp.ground.counting import counted, mm
from cellapp.ground.errors import NotConverged, with_not_fitted
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, UNTOLD, JobSteps, JobToken, SharedProgress
from cellapp.ground.threads import give_back
from cellapp.robot.effects import EFFECTS
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import prior_sigmas

_MOST_SEARCHED = 400
"""Largest number of readings to search. The cost grows with it, and some hundred readings show effects of the size of
the noise. The accepted terms are then fitted to all readings."""
_SUBSET_SEED = 0x5EA
"""Combined with the profile's seed, so that the sample of these readings is independent of all other samples."""


ArmSearch = Callable[[ArmReadings, JobSteps], "ArmFound"]
"""Search of one calibrated arm, as ``discover_arm``."""


def discover_cell(
    profile: Profile,
    model: CellModel,
    readings: Mapping[str, Readings],
    job: JobToken = UNATTENDED,
    search_arm: ArmSearch | None = None,
) -> CellDiscovery:
    """Search the readings of every arm of a calibrated cell for missing effects, and add them to the model.

    ``search_arm`` replaces ``discover_arm``.

    Raises
    ------
    Cancelled
        On request.
    """
    readings = {name: one_a_stop(its) for name, its in readings.items()}
    searched = ArmReadings.of_cell(profile, model.arms, readings)
    arms = _discover_arms(profile, searched, job, search_arm or discover_arm)
    pair = None
    if any(discovery.terms for discovery in arms.values()):
        good = {name: without(readings[name], found.result.left_out_configurations) for name, found in arms.items()}
        pair, _ = calibrate_pair(profile, good, {name: found.model for name, found in arms.items()})
    T_R_L = model.T_R_L if pair is None else pair.T_R_L
    model = replace(model, arms={name: found.model for name, found in arms.items()}, T_R_L=T_R_L)
    total = _total_steps(profile, len(arms))
    job.tell("discover", total, total, "done")
    return CellDiscovery(arms, model, pair)


def _total_steps(profile: Profile, arms: int) -> int:
    """Count the steps that discovery reports: search of every arm, training where it may be needed, and the pair."""
    training = learning_steps(profile.network) if _may_train(profile) else 0
    return (SEARCH_STEPS + training) * arms + 1


def _may_train(profile: Profile) -> bool:
    return profile.network.kind != "none" and profile.discovery.network != "never"


def _discover_arms(
    profile: Profile, arms: Mapping[str, ArmReadings], job: JobToken, search_arm: ArmSearch
) -> dict[str, ArmFound]:
    found: dict[str, ArmFound] = {}
    total = _total_steps(profile, len(arms))
    searched = SharedProgress(job, "discover", 0, total)
    for name, arm in arms.items():
        steps = searched.part(f"arm {name}")
        steps(0, "search")
        steps.check()
        found[name] = search_arm(arm, steps)
        steps(SEARCH_STEPS, found[name].result.verdict)
    if not _may_train(profile):
        return found
    trained = SharedProgress(job, "discover", SEARCH_STEPS * len(arms), total)
    with ThreadPoolExecutor(max_workers=2) as pool:  # the matrix products work outside the interpreter lock
        tasks = {}
        for name, discovery in found.items():
            steps = trained.part(f"arm {name}")
            if not needs_network(profile, discovery):
                steps(learning_steps(profile.network), "no network is needed")
                continue
            steps(0, "residual network beside the effects")
            good = ~np.isin(arms[name].readings.configuration, discovery.result.left_out_configurations)
            tasks[name] = pool.submit(with_network, arms[name].take(good), discovery, steps)
        return {**found, **{name: task.result() for name, task in tasks.items()}}


def discover_arm(
    arm: ArmReadings, steps: JobSteps = UNTOLD, prior_sigma: Mapping[str, float] | None = None
) -> ArmFound:
    """Search the identify and train splits for effects, and evaluate the models on the validate split.

    Gross errors of the geometry are left out of all splits, as ``calibrate`` leaves them out.

    There are ``SEARCH_STEPS`` steps. ``prior_sigma`` are standard deviations [m, rad] of geometric parameters about
    ``robot.model.nominal``; if None, those of the profile.
    """
    started = time.perf_counter()
    wrong = gross_errors_of_geometry(arm.model.geometry, arm.model.nominal, arm.readings)
    right = arm.take(~wrong)
    if prior_sigma is None:
        prior_sigma = prior_sigmas(arm.model.nominal, arm.profile.calibration.priors, arm.profile.arms[arm.name].fixed)
    found = search_rows(right.take(right.readings.in_split("identify", "train")), steps, prior_sigma)
    left_out = tuple(sorted({*arm.readings.configuration[wrong].tolist(), *found.left_out}))
    held_out = HeldOut.of(right)
    result = _judged_by_held_out(replace(found, left_out=left_out), held_out)
    return _evaluated(arm, result, held_out, started)


def _evaluated(arm: ArmReadings, result: Searched, held_out: HeldOut, started: float) -> ArmFound:
    """Build the discovery from a search: evidence of the effects and errors on held-out readings.

    ``started`` is the start of the search by ``time.perf_counter`` [s].
    """
    searched, found, fitted_model = result.judged, result.found, result.model
    before, after = held_out.position_mm(found.geometry_only.model), held_out.position_mm(fitted_model)
    stated_mm, noise_rad = held_out.noise_floor_mm(), noise_of(found.data).rad
    floor_mm = stated_mm * found.claim
    scan = remaining_scan(searched)
    probable = searched.posteriors or posteriors_of(searched, scan)
    terms, accepted = accepted_effects(found, fitted_model, held_out, after.rms, probable)
    spread, structure = scatter(found.data, found.fit), residual_structure(searched.data, searched.fit)
    nameless, claim = unnamed_record(found, held_out), _contradicted_claim(found, stated_mm)
    if claim is not None and spread is not None:
        spread = replace(spread, against="estimated")
    errors = BeforeAfter(before=before.rms, after=after.rms)
    word, sentence = verdict(accepted, floor_mm, errors, len(held_out), spread, structure, nameless)
    if result.harmful:
        word = "unknown effect"  # the search fitted something real, but not by its true cause
    # if nothing was found, the arm stays as it was calibrated
    final = replace(fitted_model, effects=terms) if terms else replace(arm.model, posterior=fitted_model.posterior)
    invisible, not_found = detectability(found, scan if found is searched else remaining_scan(found))
    evaluated = ArmDiscoveryResult(
        noise_floor_mm=floor_mm if math.isfinite(floor_mm) else None,
        noise_mm=_noise(found.data),
        noise_mrad=None if noise_rad is None else noise_rad * 1e3,
        heldout_mm=errors,
        heldout_position_mm=HeldOutBeforeAfter(before=before, after=after),
        heldout_orientation_mrad=held_out.rotations_before_after(found.geometry_only.model, fitted_model),
        seconds=time.perf_counter() - started,
        steps=_gap_steps(found, held_out, before.rms, after.rms, None if result.only_some else result.fitted),
        threshold=found.threshold,
        omnibus_p=None if spread is None else spread.p_value,
        scatter=None if spread is None else spread.ratio,
        accepted=accepted,
        candidates=probable.effects,
        structure=structure,
        invisible=invisible,
        not_found=not_found,
        uncertainty_mm=held_out.predicted_uncertainty_mm(final),
        pictures=pictures(found.data, found.fit),
        validate_={"effects": held_out.evaluate(final)} if terms else {},
        left_out_configurations=result.left_out,
        unnamed=nameless,
        claim=claim,
        verdict=word,
        sentence=f"arm {arm.name}: {'; '.join(filter(None, [_with_what_was_left_out(sentence, result), claim]))}",
    )
    return ArmFound(evaluated, terms, final, _scatter_m(found))


def _scatter_m(found: SearchResult) -> float:
    """Return the standard deviation of a coordinate beyond the stated one [m] if the model has smooth terms, else 0."""
    data = found.data
    if smoothness_of(found.fit.terms) is None:
        return 0.0
    points = data.points
    stated = 0.0 if data.stated is None else mean_variance(data.stated[points])
    return math.sqrt(max(mean_variance(data.sigma[points]) - stated, 0.0))


def _contradicted_claim(found: SearchResult, stated_mm: float) -> str | None:
    """Say that readings scatter less than they state, with both numbers; None if they do not."""
    if found.claim == 1.0:
        return None
    numbers = f"stated {mm(stated_mm)}, scatter {mm(stated_mm * found.claim)}"
    return f"{numbers}: an expanded or maximum figure?"


def _noise(data: ArmData) -> Noise:
    """Return the rms length of the noise: the stated one, else that estimated by the final fit (all of its scatter)."""
    points = data.points
    if data.stated is None or states_nothing(data.stated[points]):
        return Noise(rms=rms_length_mm(data.sigma[points]), source="estimated")
    return Noise(rms=rms_length_mm(data.stated[points]), source="stated")


@dataclass(frozen=True, eq=False)
class Searched:
    """Outcome of a search, and the model fitted to all readings.

    ``search`` is the result of the search, ``judged`` the one that is judged, ``found`` that of the final fit; ``data``
    are all readings. ``fitted`` is their number, None if all were searched. ``left_out`` are the configurations of
    gross errors. ``harmful`` are effects that were found but predicted held-out readings worse than without them.
    ``only_some`` says why the model rests on the searched readings only; empty if it rests on all.
    """

    search: SearchResult
    judged: SearchResult
    found: SearchResult
    model: ArmModel
    data: ArmData
    fitted: int | None
    left_out: tuple[int, ...] = ()
    harmful: tuple[str, ...] = ()
    only_some: str = ""

    @classmethod
    def of_search(cls, found: SearchResult, data: ArmData, only_some: str = "") -> Searched:
        """Return the outcome whose model rests on the searched readings."""
        fitted = None if len(found.data) == len(data) else len(data)
        model = with_posterior(found.data, found.fit, found.spread)
        return cls(found, found, found, model, data, fitted, only_some=only_some)

    def geometry_alone(self) -> Searched:
        """Return the outcome without terms, the geometry fitted again; raises ``NotConverged``."""
        found = self.found
        slugs = tuple(dict.fromkeys(term.slug for term in found.fit.terms))
        rest, model = fit_terms_to_all(found, found.data if self.only_some else self.data, (), ())
        rest = replace(rest, dropped=(*rest.dropped, *slugs), geometry_only=rest.fit)
        return replace(self, judged=rest, found=rest, model=model, harmful=slugs)


def search_rows(arm: ArmReadings, steps: JobSteps = UNTOLD, prior_sigma: Mapping[str, float] | None = None) -> Searched:
    """Search at most ``_MOST_SEARCHED`` of the readings, sampled at random, then fit to all of them.

    Gross errors that show only beside the effects found are removed in rounds; the search is repeated only if some of
    them were searched. ``prior_sigma`` as for ``discover_arm``.
    """
    order = np.arange(len(arm.readings), dtype=np.intp)
    if len(order) > _MOST_SEARCHED:
        order = np.random.default_rng([arm.profile.seed, _SUBSET_SEED]).permutation(order)
    gross, searched, found = np.zeros(len(order), dtype=np.bool_), order[:0], None
    slugs = [slug for slug in EFFECTS if slug != UNKNOWN]
    for _ in range(ROUNDS):
        kept = order[~gross[order]]
        some, every = np.sort(kept[:_MOST_SEARCHED]), np.sort(kept)
        if found is None or not np.array_equal(some, searched):
            data = ArmData.of(arm.take(some), prior_sigma)
            found, searched = search(data, slugs, steps), some
        if len(every) > len(some):
            data = ArmData.of(arm.take(every), prior_sigma)
        data = data.claiming(found.claim)
        result = _fitted_to_all(found, data, steps)
        fitted = some if result.only_some else every  # others may be far off because they were not fitted
        wrong = fitted[gross_errors_of_model(result.model, arm.take(fitted).quantities())]
        if not len(wrong):
            break
        gross[wrong] = True
    if found is not None and result.fitted is not None and not result.only_some:
        by_search = Searched.of_search(found, data, "the fit to all predicts those that were not searched worse")
        further = HeldOut(arm.take(np.setdiff1d(every, some)).quantities())
        if further.predicts_worse(result.model, by_search.model):
            result = by_search
    return replace(result, left_out=tuple(arm.readings.configuration[gross].tolist()))


def _fitted_to_all(found: SearchResult, data: ArmData, steps: JobSteps) -> Searched:
    """Fit what a search found to all readings; if that fails, the model of the search stays, with the reason."""
    if len(found.data) == len(data) or not found.fit.terms:
        return Searched.of_search(found, data)
    steps.check()
    steps(SEARCH_STEPS - 1, f"fit to all {counted(len(data), 'reading')}")
    give_back()  # memory of the search
    try:
        to_all, model = fit_to_all(found, data, max(found.threshold, SCORE_MARGIN))
    except NotConverged as error:
        return Searched.of_search(found, data, str(error))
    judged = to_all if smoothness_of(found.fit.terms) is not None else found
    return Searched(found, judged, to_all, model, data, len(data))


def _judged_by_held_out(result: Searched, held_out: HeldOut) -> Searched:
    """Return the outcome, or the geometry alone if held-out readings refute it: its terms predict them worse than none.

    They judge the whole, and select no terms.
    """
    if not result.found.fit.terms or not len(held_out):
        return result
    worse = held_out.predicts_worse(result.model, result.found.geometry_only.model)
    return result.geometry_alone() if worse else result


def _with_what_was_left_out(sentence: str, result: Searched) -> str:
    """Append to the sentence of the verdict which effects and which readings were left out."""
    said = {other.effect for one in result.found.reviews for other in one.alternatives if not other.distinguishable}
    improbable = [slug for slug in result.found.improbable if slug not in said]
    if improbable:
        titles = ", ".join(EFFECTS[slug].title for slug in improbable)
        sentence = f"{sentence}; more probably not there than there, and left out: {titles}"
    if result.only_some:
        count = f"{len(result.search.data)} of {counted(len(result.data), 'reading')}"
        sentence = f"{sentence}; the model rests on {count}: {result.only_some}"
    if result.harmful:
        sentence = (
            f"{sentence}; {_titles(result.harmful)} made held-out errors larger and was left out: measure more stops"
        )
    sentence = with_not_fitted(sentence, result.judged.not_fitted)
    return f"{sentence}; {left_out_words(result.left_out)}" if result.left_out else sentence


def _titles(slugs: Sequence[str]) -> str:
    """Join the titles of effects by commas."""
    return ", ".join(EFFECTS[slug].title if slug != UNKNOWN else "a data-driven term" for slug in slugs)


def _gap_steps(
    found: SearchResult, held_out: HeldOut, before_mm: float, after_mm: float, fitted: int | None
) -> tuple[GapStep, ...]:
    """Return the held-out error after each step of the search, and after the review."""
    errors = [(f"geometry, fitted to the {counted(len(found.data), 'reading')} searched", "", before_mm)]
    named = set[str]()
    for step in found.steps:
        if step.model is None:
            continue
        with_it = [slug for slug in dict.fromkeys(term.slug for term in step.terms) if slug not in {step.slug, *named}]
        named |= {step.slug, *with_it}
        what = f"{step.what}, with {_titles(with_it)}" if with_it else step.what
        errors.append((what, step.slug, held_out.rms_mm(step.model)))
    if found.dropped:
        errors.append((f"dropped in review: {_titles(found.dropped)}", "", after_mm))
    if fitted is not None:
        errors.append((f"fitted to all {counted(fitted, 'reading')}", "", after_mm))
    return tuple(GapStep(what=what, effect=effect, heldout_mm=error_mm) for what, effect, error_mm in errors)


# -- Residual network after discovery: a model of effects without a name ----------------------------------------------


_READINGS_A_FOLD = 2
"""Least number of readings for each fold of a network's training: one reading has no scatter."""


def needs_network(profile: Profile, discovery: ArmFound) -> bool:
    """Return whether the profile asks for a network beside the effects of this outcome, of which one stays unknown.

    There is none beside effects from recordings: samples of motion contain what no pose at rest has.
    """
    found = discovery.result
    if (found.motion is not None and found.motion.used) or (found.unnamed is not None and found.unnamed.in_force):
        return False
    asked = profile.network.kind != "none" and profile.discovery.network != "never"
    return asked and bool(discovery.terms) and found.verdict == "unknown effect"


def with_network(arm: ArmReadings, discovery: ArmFound, steps: JobSteps = UNTOLD) -> ArmFound:
    """Add to the model a network for what the accepted effects leave.

    It joins only if it predicts the left-out folds of its training readings better than none. Held-out readings judge
    the result; they do not select it.
    """
    learnt = replace(arm, model=discovery.model).take(arm.readings.in_split("identify", "train"))
    readings = learnt.readings
    if len(readings) < _READINGS_A_FOLD * arm.profile.network.folds:
        return discovery
    residual_M = readings.p_M - learnt.model.predict(readings.q, conditions=learnt.conditions)
    network = network_of_residuals(arm.profile, learnt.model, readings, residual_M, steps)
    if network is None:
        return discovery
    network = replace(network, rotation=rotation_network(arm.profile, discovery.model, learnt.quantities(), steps))
    model, held_out = replace(discovery.model, network=network), HeldOut.of(arm)
    step = GapStep(what="a network for the rest", effect="", heldout_mm=held_out.position_mm(model).rms)
    return discovery.with_model(model, held_out, steps=(*discovery.result.steps, step))
