"""Identification of one arm from recordings of its motion: the public function, and the result of a solution."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import Identification, start_from_nominal
from cellapp.estimation.calibration.least_squares import usual_scatter
from cellapp.estimation.calibration.parameters import (
    SetName,
    determined_set,
    estimated_parameters,
    prior_sds,
    prior_spreads,
    sds_of,
    sigma_by_name,
)
from cellapp.estimation.calibration.records import ClockResult, ClockSegmentResult, RecordingResult
from cellapp.estimation.motion.fit import GROSS, Solution, allow_for_missing, solve, thinned, with_lags_in_clocks
from cellapp.estimation.motion.laws import JointLaw, Masses, of_all_joints
from cellapp.estimation.motion.residuals import MotionProblem, Stops, residuals
from cellapp.estimation.motion.streams import Recording
from cellapp.estimation.motion.tracks import Track, track_of
from cellapp.ground.errors import InputError
from cellapp.ground.progress import Told, ignore_words
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.kinematics.transforms import Array

# Results of a fit of recordings: clocks, geometry, lost motion, errors of held-out blocks, undetermined parameters.


@dataclass(frozen=True, eq=False)
class RecordingFit:
    """One recording after the fit.

    Attributes
    ----------
    clock : ClockResult
    result : RecordingResult
    heldout_mm, heldout_nominal_mm : array, shape (h,)
        Distances of held-out points from the model and from the nominal arm at its base with the same clock [mm].
    track : Track
        Path and points at the fitted clock, which includes the mean lag of the joints, for later steps.
    """

    clock: ClockResult
    result: RecordingResult
    heldout_mm: Array = field(repr=False)
    heldout_nominal_mm: Array = field(repr=False)
    track: Track = field(repr=False)


@dataclass(frozen=True, eq=False)
class MotionFit:
    """One arm identified from recordings of its motion, and from stops if there are any.

    Attributes
    ----------
    identification : Identification
        Geometry, with standard errors from the noise model. Its residuals and weights are those of the stops.
    half_play : array, shape (N,)
        Lost motion in motion, by joint [rad]: a joint lies this far behind its motor, against its last motion.
    half_play_standard_error : array, shape (N,)
    recordings : mapping-like dict of RecordingFit
    stops_scatter_m : float or None
        Standard deviation of a coordinate of the stops' residuals.
    undetermined : tuple of str
        Sentences on what these data cannot determine.
    """

    identification: Identification
    half_play: Array
    half_play_standard_error: Array
    recordings: dict[str, RecordingFit]
    stops_scatter_m: float | None
    undetermined: tuple[str, ...]

    @property
    def clocks(self) -> dict[str, ClockResult]:
        """Clocks by recording."""
        return {name: one.clock for name, one in self.recordings.items()}


def rms(values: Array) -> float:
    """Return the root mean square; NaN without values."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


_RATE_SD = 3e-4
"""Prior standard deviation of a rate: clocks differ by 10 to 50 ppm; any recording shows larger differences."""
_OFFSET_SD = 1.0
"""Prior standard deviation of an offset about its start [s]: it matters only if a segment between two steps of a clock
has no training point."""
_STILL_RAD = 0.02
"""Range of a joint below which a motion contains almost no information on it."""
_FAR_MM = 10.0
"""Median distance of held-out points from the published arm at which it may be another arm."""
_FEW_DETERMINED = 2.0 / 3.0
"""Share of determined geometric parameters below which motions excite the arm little; good ones leave a fifth open."""
_BAD = 5.0
"""Ratio of a recording's scatter to that of the median recording at which it is reported as bad."""


@dataclass(frozen=True, eq=False)
class RecordedArm:
    """Data and prior knowledge of an arm recorded in motion.

    Attributes
    ----------
    nominal : Geometry
        The published chain with the nominal tool; its base is not used.
    recordings : sequence of Recording
        Recordings of this arm. Unless points are marked as held out, ``seed`` splits them into blocks of time.
    tool_unknown : bool
        Whether the estimate of the tool starts at zero.
    stops : Stops, optional
        Readings at rest, fitted jointly.
    parameter_set, prior_sigma
        As of ``calibration.identification.identify``.
    bodies, up_M
        Masses, and the direction against gravity in the tracker frame; torques are unknown unless both are given.
    seed : int
    """

    nominal: Geometry
    recordings: Sequence[Recording]
    tool_unknown: bool
    stops: Stops | None = None
    parameter_set: SetName = "auto"
    prior_sigma: Mapping[str, float] | None = None
    bodies: Bodies | None = None
    up_M: Array | None = None
    seed: int = 0


def identify_from_motion(arm: RecordedArm, told: Told = ignore_words) -> MotionFit:
    """Identify geometry, lost motion and clocks of one arm from recordings of its motion.

    ``told`` is a callback for messages on each step; an exception raised by it ends the fit.

    Raises
    ------
    InputError
        If a recording is at rest, its clocks do not overlap, its points are not of this arm, or too few are left.
    """
    problem = motion_problem(arm, told)
    solution = solve(problem, told=told)
    told("clocks")
    return motion_fit(problem, allow_for_missing(problem, solution))


def motion_problem(arm: RecordedArm, told: Told) -> MotionProblem:
    """Set up the problem of ``identify_from_motion`` (raises the same); the start is the nominal chain at the base that
    best fits the points."""
    if not arm.recordings:
        raise InputError("no recordings of motion")
    tracks = []
    for number, recording in enumerate(arm.recordings):
        told(f"start of the clocks of recording '{recording.name}'")
        tracks.append(track_of(recording, arm.nominal, tool_unknown=arm.tool_unknown, seed=arm.seed + number))
    start = start_from_nominal(arm.nominal, *_some_points(tracks, arm.stops), tool_unknown=arm.tool_unknown)
    masses = None if arm.bodies is None or arm.up_M is None else Masses(arm.nominal, arm.bodies, arm.up_M)
    if masses is not None:
        tracks = [replace(track, path=replace(track.path, inertia=masses.matrix)) for track in tracks]
        masses = replace(masses, geometry=start)
    stated = arm.prior_sigma or {}
    parameters, priors = estimated_parameters(arm.parameter_set, start, stated)
    mean = np.concatenate([start.vector()[list(parameters.columns)], *(its.clock_s for its in tracks)])
    of_clocks = [np.append(np.full(len(its.clock_s) - 1, _OFFSET_SD), _RATE_SD) for its in tracks]
    precision = np.concatenate([prior_sds(parameters, priors), *of_clocks]) ** -2.0
    spreads = prior_spreads(parameters, set(priors) - set(stated))
    bare = MotionProblem(start, parameters, (), tuple(tracks), arm.stops, mean, precision, spreads, masses)
    return bare.with_terms(of_all_joints(JointLaw.PLAY, start.joints))


def _some_points(tracks: Sequence[Track], stops: Stops | None) -> tuple[Array, Array]:
    """Return some joint positions (n, N) and points (n, 3) of all sources, at the start values of the clocks."""
    parts = [] if stops is None else [(stops.q, stops.p_M)]
    for track in tracks:
        rows = thinned(np.flatnonzero(track.learnt), 1000 // len(tracks) + 10)
        parts.append((track.path.at(track.controller_times(rows))[0], track.p_M[rows]))
    return np.concatenate([q for q, _ in parts]), np.concatenate([p for _, p in parts])


def motion_fit(problem: MotionProblem, solution: Solution) -> MotionFit:
    """Build the result of a solution."""
    found = {track.name: _recording_fit(problem, solution, number) for number, track in enumerate(problem.tracks)}
    play, play_error = np.zeros(problem.parameters.joints), np.full(problem.parameters.joints, np.nan)
    for place, term in enumerate(problem.terms, start=problem.geometric):
        if term.law is JointLaw.PLAY and term.fading is None:
            play[term.joint] = solution.values[place]
            play_error[term.joint] = math.sqrt(solution.covariance[place, place])
    identification = _identification(problem, solution)
    has_stops = problem.stops is not None and len(solution.sources[-1].rows)
    return MotionFit(
        identification=identification,
        half_play=play,
        half_play_standard_error=play_error,
        recordings=found,
        stops_scatter_m=solution.sources[-1].sigma_m if has_stops else None,
        undetermined=_undetermined(problem, identification, found),
    )


def held_out_rms_mm(problem: MotionProblem, solution: Solution) -> float:
    """Return the rms distance of all held-out points from the model, without gross errors [mm]."""
    parts = [_held_out(problem, solution, number) for number in range(len(problem.tracks))]
    return 1e3 * rms(np.concatenate([misses[good] for misses, good in parts]))


def _held_out(problem: MotionProblem, solution: Solution, number: int) -> tuple[Array, NDArray[np.bool_]]:
    """Return the distances of held-out points from the model [m], and a mask of those that are no gross errors."""
    rows = np.flatnonzero(problem.tracks[number].held_out)
    misses = np.linalg.norm(residuals(problem, solution.values, number, rows), axis=1)
    return misses, no_gross_errors(misses, solution.sources[number].sigma_m)


def no_gross_errors(misses: Array, sigma_m: float) -> NDArray[np.bool_]:
    """Return a mask of the points that are no gross errors, by distances (n,) [m] and the training scatter."""
    return np.asarray(misses < GROSS * usual_scatter(misses, sigma_m))


def _recording_fit(problem: MotionProblem, solution: Solution, number: int) -> RecordingFit:
    track, source = problem.tracks[number], solution.sources[number]
    misses, good = _held_out(problem, solution, number)
    heldout_mm = misses[good] * 1e3
    published = solution.values.copy()  # with the same clocks
    published[: problem.arm] = 0.0
    published[: problem.geometric] = problem.start.vector()[list(problem.parameters.columns)]
    nominal = np.linalg.norm(residuals(problem, published, number, np.flatnonzero(track.held_out)), axis=1)
    time_s = track.controller_times(np.arange(len(track.time_s)), solution.values[problem.clock(number)])
    result = RecordingResult(
        points=len(track.time_s),
        learnt=len(source.rows),
        held_out=len(heldout_mm),
        gross=int(track.learnt.sum()) - len(source.rows) + int(np.count_nonzero(~good)),
        in_gaps=int(np.count_nonzero(~track.path.known(time_s))),
        effective_points=min(1.0, source.worth) * len(source.rows),
        scatter_mm=source.sigma_m * 1e3,
        heldout_rms_mm=rms(heldout_mm) if len(heldout_mm) else None,
    )
    values, covariance = with_lags_in_clocks(problem, solution)
    clock_s = values[problem.clock(number)]
    errors = np.sqrt(np.diag(covariance)[problem.clock(number)])
    clock = _clock_fit(track, clock_s, errors)
    return RecordingFit(clock, result, heldout_mm, nominal[good] * 1e3, replace(track, clock_s=clock_s))


def _clock_fit(track: Track, clock_s: Array, errors: Array) -> ClockResult:
    """Return the clocks of one recording by their values and standard errors (S + 1,)."""
    first = int(track.segment[track.learnt][0])  # between steps with training points
    (offset_s, rate), (error_s, rate_error) = ((float(one[first]), 1e6 * float(one[-1])) for one in (clock_s, errors))
    times = [track.time_s[track.segment == segment][[0, -1]].tolist() for segment in range(len(clock_s) - 1)]
    return ClockResult(
        offset_s=offset_s,
        offset_standard_error_s=error_s,
        rate_ppm=rate,
        rate_standard_error_ppm=rate_error,
        at_s=track.middle_s,
        steps_of_joints=track.path.stamps.steps,
        steps_of_points=track.stamps.steps,
        segments=tuple(
            ClockSegmentResult(offset_s=value, offset_standard_error_s=error, first_s=begin, last_s=end)
            for value, error, (begin, end) in zip(clock_s[:-1].tolist(), errors[:-1].tolist(), times, strict=True)
            if len(times) > 1
        ),
        correlation=track.start.correlation,
    )


def _identification(problem: MotionProblem, solution: Solution) -> Identification:
    """Return the arm's part of the solution as an identification."""
    estimated, size, stops = problem.parameters, problem.geometric, problem.stops
    covariance = solution.covariance[:size, :size]
    information = _of_arm(solution.information, size)
    chosen = estimated
    if estimated.name == "auto":
        chosen = determined_set(estimated, information, sds_of(problem.precision[:size]))
    to_table, kept = chosen.from_estimated(estimated)
    in_table = covariance if chosen is estimated else to_table @ covariance @ to_table.T
    at_stops = np.zeros((0, 3))
    if stops is not None:
        at_stops = residuals(problem, solution.values, len(problem.tracks), np.arange(len(stops.q)))
    gram = information[kept[:, None], kept]
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return Identification(
        geometry=problem.geometry(solution.values),
        estimated=estimated,
        estimated_covariance=covariance,
        prior_sigma=sigma_by_name(estimated.names, solution.precision[:size]),
        parameter_set=chosen,
        names=chosen.names,
        units=chosen.units,
        values=problem.mean[:size][kept] + to_table @ (solution.values[:size] - problem.mean[:size]),
        covariance=in_table,
        mean=problem.mean[:size],
        precision=solution.precision[:size],
        converged=True,  # else ``solve`` refused it
        message="converged",
        scale=float(np.median([source.sigma_m for source in solution.sources])),
        degrees_of_freedom=max(1, round(3 * sum(s.worth * len(s.rows) for s in solution.sources) - problem.arm)),
        residuals=at_stops,
        weights=np.ones(len(at_stops)),
        steps=solution.steps,
        gram=gram / (scale * scale[:, None]),
        configurations=sum(len(source.rows) for source in solution.sources),
    )


def _of_arm(information: Array, size: int) -> Array:
    """Return the information about the geometry with clocks and lost motion free."""
    rest = information[size:, size:]
    with_rest = information[:size, size:]
    return np.asarray(information[:size, :size] - with_rest @ np.linalg.pinv(rest, hermitian=True) @ with_rest.T)


def _undetermined(
    problem: MotionProblem, identification: Identification, found: Mapping[str, RecordingFit]
) -> tuple[str, ...]:
    """Describe in sentences what the data cannot determine; the merged parameters are listed with all others."""
    said = []
    far_mm = [float(np.median(one.heldout_nominal_mm)) for one in found.values() if one.result.held_out]
    if far_mm and np.median(far_mm) > _FAR_MM:
        said.append(
            f"whether it is an arm of this type: the published one lies {np.median(far_mm):.0f} mm from the points"
            " wherever its base is, where some mm are usual; of another arm, all that was found holds near these"
            " motions only"
        )
    determined, of = len(identification.names), len(identification.estimated.names)
    if determined < _FEW_DETERMINED * of:
        said.append(
            f"these motions determine {determined} of {of} parameters of the geometry: predictions hold near them only;"
            " record motions of all joints, each alone and together, through a larger part of their range"
        )
    positions = [track.path.at(track.path.stamps.time_s)[0] for track in problem.tracks]
    positions += [] if problem.stops is None else [problem.stops.q]
    swings = np.ptp(np.concatenate(positions), axis=0).tolist()
    said += [
        f"joint {joint} moved by {math.degrees(swing):.2f} deg only: neither its axis nor its errors show"
        for joint, swing in enumerate(swings, start=1)
        if swing < _STILL_RAD
    ]
    said += [
        f"recording '{name}': the motion repeats, and delays of {', '.join(f'{other:.2f}' for other in others)} s would"
        " fit as well; the one with the longest overlap was taken: begin recordings with a motion that does not come"
        " again"
        for name, one in found.items()
        if (others := one.track.start.others_s)
    ]
    usual = float(np.median([one.result.scatter_mm for one in found.values()]))
    said += [
        f"recording '{name}': its points lie {one.result.scatter_mm:.2f} mm from the arm on which the other recordings"
        f" agree to {usual:.2f} mm, so that it counts little and its clock is known badly; look for an SMR that"
        " was loose or another one, an arm that slipped, a tracker that was moved"
        for name, one in found.items()
        if len(found) > 2 and one.result.scatter_mm > _BAD * usual
    ]
    return tuple(said)
