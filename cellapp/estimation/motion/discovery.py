"""Discovery for arms that were recorded in motion: effects of joints from all points, beside the search of readings.

The search of readings (stops, or samples of the recordings) knows all effects of the library. Recordings show those of
the joints far better: every reversal, dense lines, and what only motion has. Where the arm with the effects that
recordings show predicts held-out readings better, it is the model from then on; both are judged by the same ones.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.calibration.measurement_conditions import conditions_of_arms, measurement_conditions
from cellapp.estimation.discovery.accepted import accepted_effect
from cellapp.estimation.discovery.held_out import HeldOut
from cellapp.estimation.discovery.outcome import CellDiscovery, Discovery
from cellapp.estimation.discovery.records import (
    BeforeAfter,
    Evidence,
    LawRecord,
    MotionDiscoveryResult,
    MotionEffectResult,
    Picture,
    Place,
)
from cellapp.estimation.motion.calibrate import each_recorded, recorded_arm, samples_of
from cellapp.estimation.motion.effects import MotionDiscovery, effects_in_motion
from cellapp.estimation.motion.identify import RecordedArm
from cellapp.estimation.motion.loops import Loop
from cellapp.estimation.motion.steps import MotionEffect
from cellapp.estimation.motion.streams import Recording
from cellapp.estimation.motion.terms import Law
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.readings import joined
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Told, ignore, ignore_words
from cellapp.ground.results import Estimate
from cellapp.robot.effects import EFFECTS
from cellapp.robot.model import ArmModel

TITLES = {
    Law.LAG.value: "delay of a joint behind the others",
    Law.TIME_CONSTANT.value: "first-order lag of a joint behind its encoder",
    Law.INERTIA.value: "twist of a joint under its own acceleration",
    Law.VIBRATION.value: "vibration of a joint after changes of acceleration",
}
"""Of effects that act in motion only."""


@dataclass(frozen=True, eq=False)
class MotionAtRest:
    """What recordings of an arm show, its model for poses at rest, and the held-out readings that judge it.

    Samples among them stand for poses at rest, without what only motion has. A model at rest knows the last motion of a
    joint only. That of the recordings also says what the turns before left in the joints: ``held_out`` has its samples
    without that, and ``held_out_of_others``, which judges models of other data, with it.
    """

    motion: MotionDiscovery
    model: ArmModel
    held_out: HeldOut
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
        """Search the recordings of one arm. Raises as ``effects_in_motion``."""
        motion = effects_in_motion(arm, told)
        own, others = (
            _held_out(name, samples_of(motion.fit, calibrated[name].geometry.joints, joints), calibrated, stops)
            for joints in (motion.laws.joints_with_history, motion.laws.joints_at_rest)
        )
        return cls(motion, _model(calibrated[name], motion), own, others)

    @property
    def effects(self) -> tuple[MotionEffect, ...]:
        """Effects that serve poses at rest."""
        return tuple(effect for effect in self.motion.effects if effect.at_rest)

    def better_than(self, other: ArmModel) -> bool:
        """Whether there are effects whose model predicts the held-out readings better than another one."""
        if not self.motion.terms or not len(self.held_out):
            return False
        return self.held_out.rms_mm(self.model) < self.held_out_of_others.rms_mm(other)


def with_motion(
    profile: Profile,
    found: CellDiscovery,
    calibrated: Mapping[str, ArmModel],
    stops: Mapping[str, Readings],
    recordings: Mapping[str, Sequence[Recording]],
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> CellDiscovery:
    """The discovery of a cell with what recordings of its arms show.

    ``calibrated`` are the arms before discovery, ``stops`` their readings at rest.

    Raises
    ------
    Cancelled
        On request.
    """
    arms = dict(found.arms)
    for name, its, told in each_recorded(recordings, listener, cancel or CancelToken()):
        started = time.perf_counter()
        at_rest = MotionAtRest.of(recorded_arm(profile, name, stops[name], its), name, calibrated, stops, told)
        arms[name] = _with_effects(name, found.arms[name], at_rest, time.perf_counter() - started)
    model = replace(found.model, arms={name: one.model for name, one in arms.items()})
    return replace(found, arms=arms, model=model)


def _held_out(
    name: str, samples: Readings, calibrated: Mapping[str, ArmModel], stops: Mapping[str, Readings]
) -> HeldOut:
    """Held-out stops of an arm, and samples of the held-out blocks of its recordings, with the travel of each joint
    since it turned round as its last motion."""
    if not len(stops[name]):
        return HeldOut.of(samples, measurement_conditions(samples))
    apart = samples.configuration + max(int(its.configuration.max()) + 1 for its in stops.values() if len(its))
    known = {**stops, name: joined([stops[name], replace(samples, configuration=apart)])}
    return HeldOut.of(known[name], conditions_of_arms(calibrated, known)[name])


def _with_effects(name: str, found: Discovery, at_rest: MotionAtRest, seconds: float) -> Discovery:
    """The discovery of one arm with what motion shows, and with its model where that predicts better."""
    motion, used = at_rest.motion, at_rest.better_than(found.model)
    shown = MotionDiscoveryResult(
        effects=tuple(_result(effect) for effect in motion.effects),
        heldout_mm=BeforeAfter(before=motion.heldout_before_mm, after=motion.heldout_after_mm),
        used=used,
        seconds=seconds,
    )
    pictures = tuple(loop_picture(loop) for loop in motion.loops)
    if not used:
        kept = (*found.result.pictures, *pictures)
        return replace(found, result=found.result.model_copy(update={"motion": shown, "pictures": kept}))
    accepted = tuple(
        accepted_effect(
            effect.term(),
            Place(joints=effect.joints, acts_on=tuple(f"joint {joint}" for joint in effect.joints)),
            Evidence(statistic=effect.statistic, corrected_p=effect.p_value, heldout_mm=_before_after(effect)),
            effect.posterior,
        )
        for effect in at_rest.effects
    )
    names = " and ".join(EFFECTS[effect.slug].title for effect in at_rest.effects)
    after = at_rest.held_out.rms_mm(at_rest.model)
    changed = replace(found, terms=motion.terms)
    changed = replace(changed, result=found.result.model_copy(update={"accepted": accepted, "motion": shown}))
    return changed.with_model(
        at_rest.model,
        at_rest.held_out,
        verdict="explained",
        sentence=f"arm {name}: {names}, by its recordings of motion; {after * 1e3:.0f} µm rms held out",
        contradictions=(),
        pictures=pictures,
        network_mm=None,
    )


def _model(calibrated: ArmModel, motion: MotionDiscovery) -> ArmModel:
    """The arm with the geometry and the effects that motion shows and that act at rest."""
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


def loop_picture(loop: Loop) -> Picture:
    """The loop of a joint as a picture: position in degrees, lost motion in microradians."""
    return Picture(
        title=f"lost motion of joint {loop.joint} in motion",
        effect=Law.PLAY.value,
        x_label=f"joint {loop.joint} [deg]",
        y_label="behind its motor [urad]",
        x=tuple(np.degrees(loop.position).round(3).tolist()),
        measured=tuple((1e6 * loop.measured).round(3).tolist()),
        computed=tuple((1e6 * loop.computed).round(3).tolist()),
        direction=tuple(loop.direction.astype(int).tolist()),
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
