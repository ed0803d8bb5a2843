"""Discovery for arms recorded in motion: joint effects from all points, then a search of the residuals.

Recordings show effects of the joints far better than readings at rest do: every reversal, dense lines, and effects of
motion only. A search of readings knows all effects of the library. If the arm with the effects from recordings predicts
held-out readings better than without, readings (stops, and samples of the recordings) are searched at the joint
positions corrected by these effects; else as they are.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import scipy

from cellapp.estimation.calibration.quantities import conditions_of_arms, measurement_conditions
from cellapp.estimation.discovery.accepted import accepted_effect
from cellapp.estimation.discovery.discover import ArmSearch, discover_arm
from cellapp.estimation.discovery.outcome import Discovery, HeldOut
from cellapp.estimation.discovery.records import (
    AcceptedEffect,
    BeforeAfter,
    Evidence,
    GapStep,
    HeldOutBeforeAfter,
    LawRecord,
    MotionDiscoveryResult,
    MotionEffectResult,
    Place,
)
from cellapp.estimation.motion.calibrate import recorded_arm, samples_of
from cellapp.estimation.motion.effects import MotionDiscovery, effects_in_motion
from cellapp.estimation.motion.identify import RecordedArm
from cellapp.estimation.motion.laws import Law
from cellapp.estimation.motion.steps import MotionEffect
from cellapp.estimation.motion.streams import Recording
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.readings import joined
from cellapp.ground.errors import with_not_fitted
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Report, Told, ignore_report, ignore_words
from cellapp.ground.results import Estimate
from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions
from cellapp.robot.model import ArmModel

TITLES = {
    Law.LAG.value: "delay of a joint behind the others",
    Law.TIME_CONSTANT.value: "first-order lag of a joint behind its encoder",
    Law.INERTIA.value: "twist of a joint under its own acceleration",
    Law.VIBRATION.value: "vibration of a joint after changes of acceleration",
}
"""Titles of effects that act in motion only."""
_AS_IN_MOTION = 1.25
"""Ratio of errors up to which a model at rest predicts as well as that in motion: no search of readings is needed."""
_SURE = 3.0
"""Standard errors by which an effect found beside those from recordings must lower the mean squared held-out error."""


@dataclass(frozen=True, eq=False)
class SearchWithRecordings:
    """Variant of ``discover_arm`` that first searches the recordings of an arm.

    ``stops`` are the readings at rest and ``calibrated`` the arms before discovery; ``search_arm`` searches the arms
    without effects from recordings.
    """

    calibrated: Mapping[str, ArmModel]
    stops: Mapping[str, Readings]
    recordings: Mapping[str, Sequence[Recording]]
    search_arm: ArmSearch = discover_arm

    def __call__(
        self,
        profile: Profile,
        name: str,
        model: ArmModel,
        readings: Readings,
        cancel: CancelToken | None = None,
        *,
        conditions: MeasurementConditions,
        report: Report = ignore_report,
    ) -> Discovery:
        """Search one arm; ``readings`` are stops and samples of its recordings."""
        known = cancel or CancelToken()

        def told(words: str) -> None:
            known.check()
            report(0, f"recordings: {words}")

        if not self.recordings.get(name):
            return self.search_arm(profile, name, model, readings, known, conditions=conditions, report=report)
        started = time.perf_counter()
        arm = recorded_arm(profile, name, self.stops[name], self.recordings[name])
        at_rest = MotionAtRest.of(arm, name, self.calibrated, self.stops, told)
        seconds = time.perf_counter() - started

        @cache
        def searched() -> Discovery:
            return self.search_arm(profile, name, model, readings, known, conditions=conditions, report=report)

        if at_rest.stands_beside(lambda: searched().model):
            return at_rest.discovery(profile, seconds, known, report)
        found = searched()
        shown = at_rest.result(seconds, used=False)
        sentence = with_not_fitted(found.result.sentence, at_rest.motion.not_fitted)
        changes = {"motion": shown, "sentence": sentence}
        return replace(found, result=found.result.model_copy(update=changes))


@dataclass(frozen=True, eq=False)
class MotionAtRest:
    """Effects from an arm's recordings, its model for poses at rest, and the readings that judge it.

    ``readings`` (n,) are stops, and samples of the recordings converted to poses at rest. A model at rest knows only
    the last motion of a joint. The model of the recordings also knows what earlier reversals left in the joints; the
    samples exclude that. ``held_out_of_others``, which judges models from other data, includes it.
    """

    name: str
    motion: MotionDiscovery
    calibrated: ArmModel
    model: ArmModel
    readings: Readings
    conditions: MeasurementConditions
    held_out_of_others: HeldOut

    @classmethod
    def of(
        cls,
        arm: RecordedArm,
        name: str,
        calibrated: Mapping[str, ArmModel],
        stops: Mapping[str, Readings],
        told: Told = ignore_words,
    ) -> MotionAtRest:
        """Search the recordings of one arm. Raise as ``effects_in_motion``."""
        motion, before = effects_in_motion(arm, told), calibrated[name]
        own, others = (
            _with_stops(name, samples_of(motion.fit, before.geometry.joints, joints), calibrated, stops)
            for joints in (motion.laws.joints_with_history, motion.laws.joints_at_rest)
        )
        return cls(name, motion, before, _model(before, motion), *own, HeldOut.of(*others))

    @cached_property
    def held_out(self) -> HeldOut:
        """Held-out stops and samples."""
        return HeldOut.of(self.readings, self.conditions)

    @property
    def effects(self) -> tuple[MotionEffect, ...]:
        """Effects that serve poses at rest."""
        return tuple(effect for effect in self.motion.effects if effect.at_rest)

    def stands_beside(self, searched: Callable[[], ArmModel]) -> bool:
        """Return whether the model at rest with effects beats the calibrated and the searched model on held-out
        readings.

        The search runs only if held-out readings are predicted worse than the recordings in motion: some of the motion
        effects may then be no law of poses at rest.
        """
        if not self.motion.terms or not len(self.held_out):
            return False
        error_mm, others = self.held_out.rms_mm(self.model), self.held_out_of_others
        if error_mm >= others.rms_mm(self.calibrated):
            return False
        return error_mm < _AS_IN_MOTION * self.motion.heldout_after_mm or error_mm < others.rms_mm(searched())

    def result(self, seconds: float, *, used: bool) -> MotionDiscoveryResult:
        """Return the effects from the recordings, as stored in results."""
        return MotionDiscoveryResult(
            effects=tuple(_result(effect) for effect in self.motion.effects),
            heldout_mm=BeforeAfter(before=self.motion.heldout_before_mm, after=self.motion.heldout_after_mm),
            used=used,
            seconds=seconds,
        )

    def discovery(
        self, profile: Profile, seconds: float, cancel: CancelToken | None = None, report: Report = ignore_report
    ) -> Discovery:
        """Return the effects from recordings, with those that a search finds in the remaining errors of the readings.

        ``seconds`` is the time of the search of the recordings. Raise ``Cancelled`` on request.
        """
        q = self.model.true_joints(self.readings.q, conditions=self.conditions)
        bare, readings = replace(self.model, effects=(), covariance=None), replace(self.readings, q=q)
        rest = discover_arm(profile, self.name, bare, readings, cancel, conditions=self.conditions, report=report)
        if not (rest.terms and _surely_better(self.held_out, self.model, _joined(rest.model, self.model))):
            rest = _without_terms(rest)
        return self._with_rest(rest, seconds)

    def _with_rest(self, rest: Discovery, seconds: float) -> Discovery:
        """Return the discovery of the arm; ``rest`` was found at the joint positions corrected by its recordings."""
        result, model = rest.result, _joined(rest.model, self.model) if rest.terms else self.model
        before, by_motion = (
            held_out.position_mm(one)
            for held_out, one in ((self.held_out_of_others, self.calibrated), (self.held_out, self.model))
        )
        its, names = f"arm {self.name}: ", _titles(self.effects)
        steps = [GapStep(what="calibrated geometry", effect="", heldout_mm=before.rms)]
        steps.append(GapStep(what="effects that recordings show", effect="", heldout_mm=by_motion.rms))
        changed = result.model_copy(
            update={
                "accepted": (*result.accepted, *(_accepted(effect) for effect in self.effects)),
                "motion": self.result(seconds, used=True),
                "heldout_mm": BeforeAfter(before=before.rms, after=before.rms),
                "heldout_position_mm": HeldOutBeforeAfter(before=before, after=before),
                "seconds": seconds + (result.seconds or 0.0),
            }
        )
        return replace(rest, result=changed, terms=(*rest.terms, *self.motion.terms)).with_model(
            model,
            self.held_out,
            steps=(*steps, *result.steps[1:]),
            verdict="explained" if result.verdict == "nothing missing" else result.verdict,
            sentence=with_not_fitted(
                f"{its}{names}, by its recordings of motion; of the rest: {result.sentence.removeprefix(its)}",
                self.motion.not_fitted,
            ),
            uncertainty_mm=None,
        )


def _titles(named: Sequence[MotionEffect | EffectTerm]) -> str:
    return " and ".join(EFFECTS[one.slug].title for one in named)


def _surely_better(held_out: HeldOut, model: ArmModel, other: ArmModel) -> bool:
    """Return whether another model predicts held-out readings significantly better, by pairs of squared errors."""
    gain = held_out.errors_m(model) ** 2 - held_out.errors_m(other) ** 2
    return bool(np.mean(gain) > _SURE * np.std(gain) / np.sqrt(len(gain)))


def _without_terms(rest: Discovery) -> Discovery:
    """Return the search with all its terms rejected."""
    if not rest.terms:
        return rest
    result = rest.result
    changes = {"accepted": (), "verdict": "nothing missing", "contradictions": (), "steps": result.steps[:1]}
    sentence = f"{_titles(rest.terms)} would not predict held-out readings surely better, and is left out"
    return replace(rest, terms=(), result=result.model_copy(update={**changes, "sentence": sentence}))


def _joined(rest: ArmModel, by_motion: ArmModel) -> ArmModel:
    """Combine the effects found at the corrected joint positions with those from the recordings in one arm."""
    names = [name for term in by_motion.effects for name in term.names]
    assert rest.covariance is not None
    assert by_motion.covariance is not None
    of_terms = by_motion.covariance[-len(names) :, -len(names) :]
    return replace(
        rest,
        effects=(*rest.effects, *by_motion.effects),
        identified=(*rest.identified, *names),
        covariance=scipy.linalg.block_diag(rest.covariance, of_terms),
        posterior=None,
    )


def _accepted(effect: MotionEffect) -> AcceptedEffect:
    """Convert an effect from recordings to an accepted effect of the discovery."""
    return accepted_effect(
        effect.term(),
        Place(joints=effect.joints, acts_on=tuple(f"joint {joint}" for joint in effect.joints)),
        Evidence(statistic=effect.statistic, corrected_p=effect.p_value, heldout_mm=_before_after(effect)),
        effect.posterior,
    )


def _with_stops(
    name: str, samples: Readings, calibrated: Mapping[str, ArmModel], stops: Mapping[str, Readings]
) -> tuple[Readings, MeasurementConditions]:
    """Return the stops of an arm followed by samples of its recordings; the last motion of a sample is the travel of
    each joint since its reversal."""
    if not len(stops[name]):
        return samples, measurement_conditions(samples)
    apart = samples.configuration + max(int(its.configuration.max()) + 1 for its in stops.values() if len(its))
    known = {**stops, name: joined([stops[name], replace(samples, configuration=apart)])}
    return known[name], conditions_of_arms(calibrated, known)[name]


def _model(calibrated: ArmModel, motion: MotionDiscovery) -> ArmModel:
    """Return the arm with the geometry and the effects that motion shows and that act at rest."""
    identification = motion.fit.identification
    return replace(
        calibrated,
        geometry=identification.geometry,
        effects=motion.terms,
        network=None,
        identified=(*identification.estimated.names, *(name for term in motion.terms for name in term.names)),
        covariance=motion.covariance,
        posterior=None,
    )


def _before_after(effect: MotionEffect) -> BeforeAfter:
    return BeforeAfter(before=effect.heldout_before_mm, after=effect.heldout_after_mm)


def _result(effect: MotionEffect) -> MotionEffectResult:
    return MotionEffectResult(
        effect=effect.slug,
        title=EFFECTS[effect.slug].title if effect.slug in EFFECTS else TITLES[effect.slug],
        joints=effect.joints,
        parameters={
            name: Estimate(value=value, standard_error=error, unit=unit)
            for name, value, error, unit in zip(
                effect.names, effect.values.tolist(), effect.standard_errors.tolist(), effect.units, strict=True
            )
        },
        evidence=Evidence(statistic=effect.statistic, corrected_p=effect.p_value, heldout_mm=_before_after(effect)),
        only_motion=effect.only_motion or None,
        at_rest=effect.at_rest,
        law=LawRecord(name=effect.form, constants=effect.constants) if effect.at_rest else None,
    )
