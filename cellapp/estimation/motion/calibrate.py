"""Calibration and discovery with recordings of motion.

Recordings show effects of the joints far better than readings at rest do: every reversal, dense lines, and effects of
motion only. A search of readings knows all effects of the library. If the arm with the effects from recordings predicts
held-out readings better than without, readings (stops, and samples of the recordings) are searched at the joint
positions corrected by these effects; else as they are.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.calibrate import (
    ArmCalibration,
    CellCalibration,
    calibrate_readings,
    rms_length_mm,
    with_networks,
    without,
)
from cellapp.estimation.calibration.identification import start_from_nominal
from cellapp.estimation.calibration.network_training import require_learner
from cellapp.estimation.calibration.quantities import (
    ArmReadings,
    conditions_of_arms,
    evaluate,
    measurement_conditions,
    repeatability,
    summary_mm,
)
from cellapp.estimation.calibration.records import MotionResult
from cellapp.estimation.discovery.accepted import accepted_effect
from cellapp.estimation.discovery.discover import ArmSearch, discover_arm
from cellapp.estimation.discovery.outcome import ArmFound, HeldOut
from cellapp.estimation.discovery.records import (
    AcceptedEffect,
    BeforeAfter,
    GapStep,
    HeldOutBeforeAfter,
    HeldOutPosition,
    MotionDiscoveryResult,
    Place,
)
from cellapp.estimation.motion.effects import MotionDiscovery, effects_in_motion
from cellapp.estimation.motion.fit import thinned
from cellapp.estimation.motion.identify import (
    MotionFit,
    RecordedArm,
    RecordingFit,
    identify_from_motion,
    no_gross_errors,
)
from cellapp.estimation.motion.laws import TimedPath
from cellapp.estimation.motion.residuals import Stops
from cellapp.estimation.motion.search_state import MotionEffect
from cellapp.estimation.motion.streams import Recording
from cellapp.estimation.readings import SPLITS, Readings, coordinate_uncertainty, stated_uncertainty
from cellapp.estimation.readings.readings import joined
from cellapp.ground.errors import InputError, with_not_fitted
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, UNTOLD, JobSteps, JobToken, Told, ignore_words
from cellapp.ground.results import Estimate, Stage, StageErrors
from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array, invert
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm, prior_sigmas, up_in_tracker

_SAMPLES = 1500
"""Number of samples of an arm's recordings that replace readings if none was taken at rest."""
_APART_S = 0.3
"""Least mean time between two samples: correlated errors of nearer neighbours would pass for a law."""
_PAST_PLAY_RAD = 1e-3
"""Travel since a reversal after which a joint has taken up any play: before, its side is none of a joint at rest."""
_MOVES_RAD = 0.02
"""Range of motion below which a joint has no distinguishable sides."""
_TRIED = 3
"""Number of candidate points for each sample."""


def calibrate_with_motion(
    profile: Profile,
    readings: Mapping[str, Readings],
    recordings: Mapping[str, Sequence[Recording]],
    job: JobToken = UNATTENDED,
) -> tuple[CellCalibration, dict[str, Readings]]:
    """Calibrate a cell: arms with ``recordings`` from these and their readings, others from readings with random
    splits. Return also samples (as readings) of the recorded arms.

    Raises
    ------
    InputError
        If an arm has too few readings, or a recording is of no use, see ``identify_from_motion``.
    Cancelled
        If the token says so.
    """
    known: dict[str, ArmCalibration] = {}
    samples: dict[str, Readings] = {}
    notes: list[str] = []
    require_learner(profile.network)
    for name, its, told in each_recorded(recordings, job):
        fit, arm = calibrate_arm_with_motion(profile, name, readings[name], its, told)
        if profile.network.kind == "batches":
            arm = train_arm_in_motion(profile, arm, readings[name], fit, job, told)
        known[name] = arm
        samples[name] = samples_of(fit)
    found = calibrate_readings(profile, readings, job, known=known)
    if found.pair is None and len(known) == len(profile.arms) == 2:
        T_M_first, T_M_second = (arm.model.geometry.T_M_B() for arm in found.arms.values())
        first, second = profile.arms
        model = replace(found.model, T_R_L=np.asarray(invert(T_M_second) @ T_M_first), pair=(first, second))
        found = replace(found, model=model)
        notes.append("pair: the transform between the bases is that of both arms in the tracker's frame")
    return replace(found, notes=(*found.notes, *notes)), samples


def each_recorded(
    recordings: Mapping[str, Sequence[Recording]], job: JobToken
) -> Iterator[tuple[str, Sequence[Recording], Told]]:
    """Yield each recorded arm with its recordings and a message callback, which raises ``Cancelled`` on request."""
    moved = {name: its for name, its in recordings.items() if its}
    for number, (name, its) in enumerate(moved.items()):

        def told(words: str, done: int = number, arm: str = name) -> None:
            job.check()
            job.tell("recordings of motion", done, len(moved), f"arm {arm}: {words}")

        yield name, its, told
    job.tell("recordings of motion", len(moved), len(moved), "done")


def recorded_arm(profile: Profile, name: str, readings: Readings, recordings: Sequence[Recording]) -> RecordedArm:
    """Collect an arm's recordings and readings at rest; of the readings only the identify split is used."""
    arm, settings = profile.arms[name], profile.calibration
    nominal = nominal_arm(arm)
    return RecordedArm(
        nominal,
        recordings,
        tool_unknown=arm.smr.offset == "unknown",
        stops=_stops(readings),
        parameter_set=settings.parameter_set,
        prior_sigma=prior_sigmas(nominal, settings.priors, arm.fixed),
        bodies=bodies_of(arm),
        up_M=up_in_tracker(profile),
        seed=profile.seed,
    )


def calibrate_arm_with_motion(
    profile: Profile, name: str, readings: Readings, recordings: Sequence[Recording], told: Told = ignore_words
) -> tuple[MotionFit, ArmCalibration]:
    """Calibrate one arm from its recordings and, if there are any, from the readings of its identify split."""
    recorded = recorded_arm(profile, name, readings, recordings)
    fit = identify_from_motion(recorded, told)
    found, some = fit.identification, samples_of(fit)
    start = start_from_nominal(recorded.nominal, some.q, some.p_M, tool_unknown=recorded.tool_unknown)
    held_out = readings.take(readings.in_split("validate"))
    in_motion = _errors_in_motion(name, fit)
    points = {"identify": sum(one.result.learnt for one in fit.recordings.values()), "train": 0}
    points["validate"] = sum(one.result.held_out for one in fit.recordings.values())
    return fit, ArmCalibration(
        model=ArmModel.of(profile, name, found.geometry, start, found.estimated.names, found.estimated_covariance),
        identification=found,
        excess_m=0.0,
        validate=_errors_at_rest(start, found.geometry, held_out) if len(held_out) else in_motion,
        counts={word: len(readings.in_split(word)) for word in SPLITS} if len(readings) else points,
        repeatability=repeatability(readings.q, readings.p_M) if len(readings) else None,
        tracker_mm=_stated_mm(readings, recordings),
        motion=_motion_result(fit, in_motion),
        clocks=fit.clocks,
    )


def samples_of(fit: MotionFit, at_rest: Callable[[TimedPath, Array], Array] | None = None) -> Readings:
    """Return samples of all recordings, with the joint positions at their times, as readings: of the training points
    and of the held-out blocks. ``at_rest`` maps a path and times (n,) to the joint positions (n, N) at which an arm at
    rest has the points of these times; without it, those of the path are used."""
    parts = []
    for one in fit.recordings.values():
        share = _SAMPLES // len(fit.recordings) + 1
        for word, chosen, most in (("identify", one.track.learnt, share), ("validate", one.track.held_out, share // 3)):
            most = min(most, math.ceil(np.count_nonzero(chosen) * one.track.stamps.period_s / _APART_S))
            rows = _past_reversals(one, thinned(np.flatnonzero(chosen), _TRIED * most))
            parts.append((word, one, thinned(rows, most)))
    times = [(one.track.path, one.track.controller_times(rows)) for _, one, rows in parts]
    q = [path.at(time_s)[0] if at_rest is None else at_rest(path, time_s) for path, time_s in times]
    stated = [one.track.sigma_m[rows] for _, one, rows in parts if one.track.sigma_m is not None]
    sides = [path.direction_at(time_s) for path, time_s in times]
    travelled = [path.travel_at(time_s, path.at(time_s)[0]) for path, time_s in times]
    return Readings(
        configuration=np.arange(sum(len(rows) for *_, rows in parts)),
        time_s=np.concatenate([one.track.time_s[rows] for _, one, rows in parts]),
        q=np.concatenate(q),
        approach=np.sign(np.rint(np.concatenate(sides))).astype(np.int8),
        p_M=np.concatenate([one.track.p_M[rows] for _, one, rows in parts]),
        sigma_m=np.concatenate(stated) if len(stated) == len(parts) else None,
        step=np.concatenate(travelled),
        other_q=_beside(times),
        split=tuple(word for word, _, rows in parts for _ in rows),
    )


def _past_reversals(one: RecordingFit, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the points at which no joint has just reversed; all points if there is none."""
    path, time_s = one.track.path, one.track.controller_times(rows)
    q = path.at(time_s)[0]
    moves = np.ptp(q, axis=0) > _MOVES_RAD if len(q) else np.zeros(q.shape[1], dtype=np.bool_)
    past = (np.abs(path.travel_at(time_s, q)) > _PAST_PLAY_RAD)[:, moves].all(axis=1)
    return rows[past] if past.any() else rows


def _beside(times: Sequence[tuple[TimedPath, Array]]) -> Array | None:
    """Return the joint positions (n, K) of the other arm at times of paths; None if no recording has them."""
    found = [path.beside_at(time_s) for path, time_s in times]
    joints = max((q.shape[1] for q in found if q is not None), default=0)
    if not joints:
        return None
    unknown = [np.full((len(time_s), joints), np.nan) for _, time_s in times]
    return np.concatenate([blank if q is None else q for q, blank in zip(found, unknown, strict=True)])


def _stops(readings: Readings) -> Stops | None:
    """Return the readings at rest for a fit with recordings; None if none may be used."""
    learnt = np.zeros(len(readings), dtype=bool)
    learnt[readings.in_split("identify")] = True
    if not learnt.any():
        return None
    approach = readings.approach.astype(np.float64)
    return Stops(readings.q, readings.p_M, coordinate_uncertainty(readings), approach, learnt, readings.step)


def _errors_at_rest(nominal: Geometry, found: Geometry, held_out: Readings) -> dict[Stage, StageErrors]:
    arms: dict[Stage, Geometry] = {"nominal": nominal, "geometry": found}
    return {stage: evaluate(held_out.p_M, smr_positions(arm, held_out.q), held_out.q) for stage, arm in arms.items()}


def _errors_in_motion(name: str, fit: MotionFit) -> dict[Stage, StageErrors]:
    """Return the errors at the points of the held-out blocks of all recordings."""
    ones = fit.recordings.values()
    nominal, found = (np.concatenate(parts) for parts in zip(*((o.heldout_nominal_mm, o.heldout_mm) for o in ones)))
    if not len(found):
        raise InputError(
            f"arm '{name}': no point of its recordings is held out to judge the fit; give blocks the split 'validate',"
            " or leave the column out"
        )
    errors: dict[Stage, Array] = {"nominal": nominal, "geometry": found}
    return {stage: StageErrors(position_mm=summary_mm(mm)) for stage, mm in errors.items()}


def _stated_mm(readings: Readings, recordings: Sequence[Recording]) -> float | None:
    """Return the rms length of the stated noise [mm] of readings, else of recorded points; None if not stated."""
    stated = stated_uncertainty(readings) if len(readings) else None
    if stated is None:
        sigmas = [one.points.sigma_m for one in recordings]
        stated = None if any(one is None for one in sigmas) else np.concatenate([s for s in sigmas if s is not None])
    return None if stated is None else rms_length_mm(stated)


# -- the result -------------------------------------------------------------------------------------------------------


def _motion_result(fit: MotionFit, errors: Mapping[Stage, StageErrors]) -> MotionResult:
    play, error, N = fit.half_play.tolist(), fit.half_play_standard_error.tolist(), len(fit.half_play)
    return MotionResult(
        recordings={name: one.result for name, one in fit.recordings.items()},
        effective_points=sum(one.result.effective_points for one in fit.recordings.values()),
        half_play=Estimate.by_name([f"joint {joint}" for joint in range(1, N + 1)], play, error, ["rad"] * N),
        stops_scatter_mm=None if fit.stops_scatter_m is None else fit.stops_scatter_m * 1e3,
        validate_=errors,
        undetermined=fit.undetermined,
    )


# -- Residual network from all points of an arm's recordings, and from its readings at rest ---------------------------


_Residuals = tuple[Array, Array]
"""Joints (n, N) [rad] and residuals of geometry and lost motion (n, 3) [m] there."""


def train_arm_in_motion(
    profile: Profile, arm: ArmCalibration, readings: Readings, fit: MotionFit, job: JobToken, told: Told
) -> ArmCalibration:
    """Train a network for an arm on all points of its recordings outside held-out blocks, and on those of its
    ``readings`` at rest that may teach. Its held-out errors are at rest if it has such readings, else in motion.

    Lost motion is subtracted: it depends on the direction of approach, which a function of posture cannot represent.
    """
    rows = readings.in_split("train")
    stops = without(readings.take(rows if len(rows) else readings.in_split("identify")), arm.left_out)
    parts = [_points(fit, one, held_out=False) for one in fit.recordings.values()]
    if len(stops):
        loaded = MeasurementConditions(approach=stops.approach, payload_kg=stops.payload_kg)
        parts = [(stops.q, stops.p_M - arm.model.predict(stops.q, conditions=loaded)), *parts]
    q, off_M = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    in_order = np.arange(float(len(q)))  # in order of time in each recording, by which blocks are cut
    arm = with_networks(profile, arm, q, off_M, in_order, JobSteps(lambda _, words: told(words), job))
    if arm.model.network is None:
        return arm
    q, off_M = _held_out(arm, readings, fit)
    correction = arm.model.network.correct(q) @ arm.model.geometry.T_M_B()[:3, :3].T
    mm = np.linalg.norm(off_M - correction, axis=1) * 1e3
    return replace(arm, validate={**arm.validate, "network": StageErrors(position_mm=summary_mm(mm))})


def _held_out(arm: ArmCalibration, readings: Readings, fit: MotionFit) -> _Residuals:
    """Return the residuals where the other stages are judged: at held-out readings at rest, else in held-out blocks."""
    stops = without(readings.take(readings.in_split("validate")), arm.left_out)
    if len(stops):
        return stops.q, stops.p_M - smr_positions(arm.model.geometry, stops.q)
    parts = [_points(fit, one, held_out=True) for one in fit.recordings.values()]
    q, off_M = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return q, off_M


def _points(fit: MotionFit, one: RecordingFit, *, held_out: bool) -> _Residuals:
    """Return the points of a recording without gross errors."""
    track = one.track
    rows = np.flatnonzero(track.held_out if held_out else track.learnt)
    time_s = track.controller_times(rows)
    q, _ = track.path.at(time_s)
    moved = q - fit.half_play * track.path.direction_at(time_s)
    off_M = track.p_M[rows] - smr_positions(fit.identification.geometry, moved)
    good = no_gross_errors(np.linalg.norm(off_M, axis=1), one.result.scatter_mm * 1e-3)
    return q[good], off_M[good]


# -- Discovery --------------------------------------------------------------------------------------------------------


_AS_IN_MOTION = 1.25
"""Ratio of errors up to which a model at rest predicts as well as that in motion: no search of readings is needed."""


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

    def __call__(self, arm: ArmReadings, steps: JobSteps = UNTOLD) -> ArmFound:
        """Search one arm; its readings are stops and samples of its recordings.

        The arm at rest with effects from recordings must beat the calibrated and the searched arm on held-out readings.
        The search runs only if these are predicted worse than the recordings in motion: some of the motion effects may
        then be no law of poses at rest. A model at rest knows only the last motion of a joint. The model of the
        recordings also knows what earlier reversals left in the joints; its own samples exclude that, those that judge
        models from other data include it.
        """
        if not self.recordings.get(arm.name):
            return self.search_arm(arm, steps)
        motion, result = self._in_motion(arm, steps)
        calibrated = self.calibrated[arm.name]
        own = self._at_rest(arm, motion, motion.joints_with_history)
        held_out, of_others = map(HeldOut.of, (own, self._at_rest(arm, motion, motion.joints_at_rest)))
        found = None
        if motion.at_rest and len(held_out):
            error_mm, before = held_out.rms_mm(own.model), of_others.position_mm(calibrated)
            if error_mm < before.rms:
                if error_mm >= _AS_IN_MOTION * motion.heldout_after_mm:
                    found = self.search_arm(arm, steps)
                if found is None or error_mm < of_others.rms_mm(found.model):
                    return _beside_motion(own, motion, held_out, before, result, steps)
        found = found or self.search_arm(arm, steps)
        sentence = with_not_fitted(found.result.sentence, motion.not_fitted)
        return replace(found, result=found.result.model_copy(update={"motion": result, "sentence": sentence}))

    def _in_motion(self, arm: ArmReadings, steps: JobSteps) -> tuple[MotionDiscovery, MotionDiscoveryResult]:
        """Search the recordings of one arm; return also what is stored of it."""

        def told(words: str) -> None:
            steps.check()
            steps(0, f"recordings: {words}")

        started, name = time.perf_counter(), arm.name
        recorded = recorded_arm(arm.profile, name, self.stops[name], self.recordings[name])
        motion = effects_in_motion(recorded, told)
        return motion, MotionDiscoveryResult(
            effects=tuple(effect.found for effect in motion.effects),
            heldout_mm=BeforeAfter(before=motion.heldout_before_mm, after=motion.heldout_after_mm),
            used=False,
            seconds=time.perf_counter() - started,
        )

    def _at_rest(
        self, arm: ArmReadings, motion: MotionDiscovery, joints: Callable[[TimedPath, Array], Array]
    ) -> ArmReadings:
        """Return the arm with the geometry and the effects that motion shows and that act at rest, and its stops
        followed by samples of its recordings, converted by ``joints``."""
        name, identification, terms = arm.name, motion.fit.identification, motion.terms
        model = replace(
            self.calibrated[name],
            geometry=identification.geometry,
            effects=terms,
            network=None,
            identified=(*identification.estimated.names, *(parameter for term in terms for parameter in term.names)),
            covariance=motion.covariance,
            posterior=None,
        )
        samples = samples_of(motion.fit, joints)
        if not len(self.stops[name]):
            return replace(arm, model=model, readings=samples, conditions=measurement_conditions(samples))
        # the last motion of a sample is the travel of each joint since its reversal
        apart = samples.configuration + max(int(its.configuration.max()) + 1 for its in self.stops.values() if len(its))
        known = {**self.stops, name: joined([self.stops[name], replace(samples, configuration=apart)])}
        conditions = conditions_of_arms(self.calibrated, known)[name]
        return replace(arm, model=model, readings=known[name], conditions=conditions)


def _beside_motion(
    own: ArmReadings,
    motion: MotionDiscovery,
    held_out: HeldOut,
    before: HeldOutPosition,
    result: MotionDiscoveryResult,
    steps: JobSteps,
) -> ArmFound:
    """Return the effects from recordings, with those that a search finds in the remaining errors of the readings.

    ``before`` are the errors of the calibrated arm. Raise ``Cancelled`` on request.
    """
    model = own.model
    q = model.true_joints(own.readings.q, conditions=own.conditions)
    bare = replace(model, effects=(), covariance=None)
    rest = discover_arm(replace(own, model=bare, readings=replace(own.readings, q=q)), steps)
    with_rest = _joined_models(rest.model, model) if rest.terms else model
    if rest.terms and not held_out.predicts_worse(model, with_rest):
        rest, with_rest = _without_terms(rest), model
    found, by_motion, its = rest.result, held_out.rms_mm(model), f"arm {own.name}: "
    changed = found.model_copy(
        update={
            "accepted": (*found.accepted, *map(_accepted, motion.at_rest)),
            "motion": result.model_copy(update={"used": True}),
            "heldout_mm": BeforeAfter(before=before.rms, after=before.rms),
            "heldout_position_mm": HeldOutBeforeAfter(before=before, after=before),
            "seconds": (result.seconds or 0.0) + (found.seconds or 0.0),
        }
    )
    of_rest = f"of the rest: {found.sentence.removeprefix(its)}"
    sentence = f"{its}{_titles(motion.terms)}, by its recordings of motion; {of_rest}"
    return replace(rest, result=changed, terms=(*rest.terms, *motion.terms)).with_model(
        with_rest,
        held_out,
        steps=(
            GapStep(what="calibrated geometry", effect="", heldout_mm=before.rms),
            GapStep(what="effects that recordings show", effect="", heldout_mm=by_motion),
            *found.steps[1:],
        ),
        verdict="explained" if found.verdict == "nothing missing" else found.verdict,
        sentence=with_not_fitted(sentence, motion.not_fitted),
        uncertainty_mm=None,
    )


def _titles(named: Sequence[EffectTerm]) -> str:
    return " and ".join(EFFECTS[one.slug].title for one in named)


def _without_terms(rest: ArmFound) -> ArmFound:
    """Return the search with all its terms rejected."""
    result = rest.result
    changes = {"accepted": (), "verdict": "nothing missing", "steps": result.steps[:1]}
    sentence = f"{_titles(rest.terms)} would not predict held-out readings surely better, and is left out"
    return replace(rest, terms=(), result=result.model_copy(update={**changes, "sentence": sentence}))


def _joined_models(rest: ArmModel, by_motion: ArmModel) -> ArmModel:
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
    joints = effect.found.joints
    where = Place(joints=joints, acts_on=tuple(f"joint {joint}" for joint in joints))
    return accepted_effect(effect.term(), where, effect.found.evidence, effect.posterior)
