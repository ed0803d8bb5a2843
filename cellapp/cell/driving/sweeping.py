"""Record sweeps while a run is collected: at a measured stop each arm swings and is recorded, while the others rest, or
the other one swings too.

A simulated cell computes a sweep at once; real arms are driven and recorded through their drivers.

Drive and record one sweep of one arm through its drivers: the controller's samples and the tracker's points.

If another arm swings at the same time, both are driven together and the joints of both are recorded; the tracker
follows the first. The timestamps of the second controller are converted to the first one's clock by the states of both
at the beginning.

Recording begins before the motion and ends after it, at rest; each device has timestamps of its own clock. If the beam
breaks, the arm slows down along its path and rests; the tracker is pointed at the SMR again, and the arm continues from
there: that is a separate recording.

Handle breaks of the beam to a moving SMR: the arm slows down along its path; at rest the SMR is found again.

Drive a path of one arm while the tracker follows its SMR; drive it again if the beam broke.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.motion import WRONG_TARGET_M, Mover, sweep_sentence
from cellapp.cell.driving.reaction import StopCause, StopReaction
from cellapp.cell.planning.sweeps import PlannedSweep, read_sweeps, refuse_sweep
from cellapp.cell.run import RunFile
from cellapp.cell.run.columns import POINT
from cellapp.cell.run.recordings import recording_states, store_recording
from cellapp.cell.run.recordings_csv import RecordedStreams, checked_recording
from cellapp.cell.run.stream_csv import StreamTable
from cellapp.cell.safety.gate import predicted_smr
from cellapp.estimation.iso9283.evaluate import PathTrack
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.progress import SweepLive
from cellapp.robot.kinematics.transforms import Array, rows_at
from cellapp.robot.paths.joint_path import Sweep, Trajectory
from drivers.arms.protocol import Arm, ArmError, PathFollower
from drivers.arms.recording import JointRecord, RecordingArm
from drivers.trackers.protocol import TargetLost, Track, TrackerError, WrongTarget, stream_limits_of, stream_of

_TRIES = 3
"""Tries to find the SMR after a break; between them a person in the beam has ``_PAUSE_S`` [s] to leave."""
_PAUSE_S = 1.0


class Beam:
    """First packet and error of a track. Both methods may be called from any thread.

    Attributes
    ----------
    first : Track or None
        First packet with a point.
    error : TrackerError or None
        Why the track ended: ``TargetLost`` if the beam broke, else the tracker died.
    """

    def __init__(self, moving: Sequence[PathFollower], reaction: StopReaction) -> None:
        self.first: Track | None = None
        self.error: TrackerError | None = None
        self._moving, self._reaction = moving, reaction

    def received(self, packet: Track) -> None:
        """Store the first packet with a point."""
        if self.first is None and len(packet.p_M):
            self.first = packet

    def lost(self, error: TrackerError) -> None:
        """Let all moving arms slow down along their paths and rest; if the tracker died, stop the cell."""
        self.error = error
        if not isinstance(error, TargetLost):
            self._reaction.trigger(StopCause("tracker", str(error)))
            return
        for arm in self._moving:
            with suppress(ArmError):  # the arm's own fault stops the cell
                arm.end_path()


def find_again(mover: Mover, name: str) -> None:
    """Measure the SMR of an arm at rest where its beam broke, with retries. Raise ``TrackerError``, ``Cancelled``."""
    for remaining in range(_TRIES, 0, -1):
        try:
            mover.measure(name, mover.positions()[name])
            return
        except (TargetLost, WrongTarget):
            if remaining == 1:
                raise
        mover.wait(_PAUSE_S)


_REST_S = 0.5
"""Recorded rest before and after the motion [s]."""
_STARTS_S = 1.0
"""Time to full speed [s] of a motion that continues in the middle of its path."""
_FIRST_POINT_S = 1.0
_MOST_PARTS = 20
_SHORTEST_S = 0.5
"""Shorter parts [s] carry no information and are discarded."""


@dataclass(frozen=True)
class SweepPart:
    """Recording up to a break of the beam, or up to the end of the motion.

    ``reached_s`` is the time of the motion at which the arm came to rest [s]; None if at its end. ``beside`` are joint
    positions (n, K) [rad] of the arm that swung at the same time, at the timestamps of ``joints``.
    """

    joints: JointRecord
    track: Track
    reached_s: float | None
    beside: Array | None = None


def why_no_sweeps(cell: Cell, interval_s: float) -> str:
    """Return why sweeps cannot be recorded in a cell; empty if they can. Raise ``TrackerError``."""
    limits = stream_limits_of(cell.tracker)
    if limits is None:
        return "this tracker's driver does not measure an SMR while it moves"
    try:
        limits.check(interval_s)
    except ValueError as error:
        return f"collection.motion_rate: {error}"
    for name, arm in cell.arms.items():
        if not (isinstance(arm, PathFollower) and isinstance(arm, RecordingArm)):
            return f"arm {name}: its driver cannot follow and record a motion"
    return ""


@runtime_checkable
class _FollowedAndRecorded(Arm, PathFollower, RecordingArm, Protocol):
    """Arm of a cell in which sweeps can be recorded."""


@dataclass(frozen=True, eq=False)
class _Leg:
    """Path that an arm follows next: positions ``q`` (m, N) [rad], and their times ``s_s`` (m,) in its motion [s]."""

    arm: _FollowedAndRecorded
    q: Array
    s_s: Array

    def at_s(self, reached: float) -> float | None:
        """Return the time of the motion at a (fractional) row; None at the end."""
        early = reached < len(self.q) - 1
        return float(np.interp(reached, np.arange(len(self.s_s)), self.s_s)) if early else None


@dataclass
class DrivenSweep:
    """A sweep of an open cell, driven and recorded in parts.

    ``motions`` are those of all moving arms, which are at their beginnings; the first arm is measured. ``interval_s``
    is the time between two points of the tracker [s]. ``note`` receives warnings for a person; ``tell`` each report
    for those who look on, of which ``live`` is the last.
    """

    mover: Mover
    interval_s: float
    motions: Mapping[str, Sweep]
    note: Callable[[str], None]
    tell: Callable[[SweepLive], None]
    live: SweepLive

    def parts(self) -> Iterator[SweepPart]:
        """Drive one period of the motions; yield each part when it is recorded.

        Raises
        ------
        MotionRefused
            If the gate refuses; the arms rest.
        CellStopped
            If anything stops the cell.
        TrackerError
            If the SMR is not found before the motion begins.
        """
        motions, name, from_s = self.motions, next(iter(self.motions)), dict.fromkeys(self.motions, 0.0)
        for part in range(1, _MOST_PARTS + 1):
            try:
                if part > 1:
                    find_again(self.mover, name)
                found, reached = self._recorded(self._legs(from_s))
            except (TargetLost, WrongTarget) as error:
                if part == 1:
                    raise
                self.note(f"arm {name}: the rest of its sweep is not recorded: {error}")
                break
            if found.reached_s is None or found.reached_s - from_s[name] > _SHORTEST_S:
                yield found
            if all(its_s is None for its_s in reached.values()):
                return
            from_s = {one: motions[one].period_s if its_s is None else its_s for one, its_s in reached.items()}
            if found.reached_s is None:
                break  # the beam broke at the end: the other arm completes its motion
            self.note(f"arm {name}: the beam broke {from_s[name]:.1f} s after its sweep began; it goes on from there")
        self._follow(self._legs(from_s), "unrecorded")
        self._report(state="done", done_s=self.live.duration_s)

    def _legs(self, from_s: Mapping[str, float]) -> dict[str, _Leg]:
        found = {}
        for name, motion in self.motions.items():
            arm = self.mover.cell.arms[name]
            assert isinstance(arm, _FollowedAndRecorded)
            found[name] = _Leg(arm, *_rest_of(motion, from_s[name], arm.path_period_s))
        return found

    def _follow(self, legs: Mapping[str, _Leg], state: Literal["moving", "unrecorded"]) -> dict[str, float | None]:
        """Let arms follow their legs; return the motion time at which each rested early [s], None if at its end."""
        own, clock = next(iter(legs.values())), self.mover.cell.clock
        began_s: float | None = None

        def look() -> None:
            nonlocal began_s
            now_s = clock.now_s()
            began_s = now_s if began_s is None else began_s
            done_s = np.interp((now_s - began_s) / own.arm.path_period_s, np.arange(len(own.s_s)), own.s_s)
            self._report(state=state, done_s=float(done_s))

        reached = self.mover.follow({name: (leg.q, leg.arm.path_period_s) for name, leg in legs.items()}, look)
        return {name: leg.at_s(reached[name]) for name, leg in legs.items()}

    def _report(self, **now: Any) -> None:
        self.live = replace(self.live, **now)
        self.tell(self.live)

    def _recorded(self, legs: Mapping[str, _Leg]) -> tuple[SweepPart, Mapping[str, float | None]]:
        """Let arms follow their legs while recording; the tracker follows the first one.

        Return the part, and where each arm came to rest as ``_follow``.
        """
        mover, arms = self.mover, {one: leg.arm for one, leg in legs.items()}
        name, streaming = next(iter(legs)), stream_of(mover.cell.tracker)
        assert streaming is not None
        beam = Beam([*arms.values()], mover.reaction)
        try:
            mover.ask_all({one: arm.start_recording for one, arm in arms.items()})
            states = mover.ask_all({one: arm.state for one, arm in arms.items()})
            expected_M = predicted_smr(mover.bodies, name, legs[name].q[:1])[0]
            streaming.start_track(expected_M, self.interval_s, beam.lost, beam.received)
            mover.wait(_REST_S)
            self._require_own(name, beam, expected_M)
            reached = self._follow(legs, "moving")
            mover.wait(_REST_S)
            records = mover.ask_all({one: arm.end_recording for one, arm in arms.items()})
            track = streaming.end_track()
        except BaseException:  # the original error is the one to report
            for arm in arms.values():
                with suppress(ArmError):
                    arm.end_recording()
            with suppress(TrackerError):
                streaming.end_track()
            raise
        if (reached_s := reached[name]) is None:
            self._report(state="done", done_s=self.live.duration_s)
        else:
            self._report(state="searching", done_s=reached_s, lost_beams=self.live.lost_beams + 1)
        own = records.pop(name)
        later_s = {one: states[name].time_s - its.time_s for one, its in states.items()}  # to some control cycles
        beside = [rows_at(own.time_s, its.time_s + later_s[one], its.q) for one, its in records.items()]
        return SweepPart(own, track, reached_s, *beside), reached

    def _require_own(self, name: str, beam: Beam, expected_M: Array) -> None:
        """Check that points arrive and belong to this arm's SMR. Raise ``TrackerError`` if not."""
        self.mover.cell.tracker.confirm(_FIRST_POINT_S)
        if beam.error is not None:
            raise beam.error
        if beam.first is None:
            raise TargetLost(f"tracker: no point of arm {name} came while it rested")
        off_m = float(np.linalg.norm(beam.first.p_M[0] - expected_M))
        if off_m > WRONG_TARGET_M:
            raise WrongTarget(
                f"arm {name}: the tracker locked an SMR {off_m * 1e3:.0f} mm from where this one should be"
            )


def _rest_of(sweep: Sweep, from_s: float, period_s: float) -> tuple[Array, Array]:
    """Return the motion from ``from_s`` [s] on: joint positions (m, N) [rad], one per ``period_s``, and their times in
    the motion (m,) [s]. In the middle of the path it starts slowly from rest."""
    rows = int(np.ceil(sweep.period_s / period_s))
    exact = replace(sweep, period_s=rows * period_s)
    scale = exact.period_s / sweep.period_s
    if from_s <= 0.0:
        s_s = np.asarray(np.arange(rows + 1) * period_s, dtype=np.float64)
        return exact.at(s_s), s_s / scale
    steps = max(round(_STARTS_S / period_s), 1)
    rate: Array = 0.5 * (1.0 - np.cos(np.pi * np.arange(1, steps + 1) / steps))
    ramp = from_s * scale + period_s * np.concatenate([[0.0], np.cumsum(rate)])
    remaining = max(int(np.ceil((exact.period_s - ramp[-1]) / period_s)), 0)
    s_s = np.minimum(np.concatenate([ramp, ramp[-1] + period_s * np.arange(1, remaining + 1)]), exact.period_s)
    return exact.at(s_s), s_s / scale


CYCLE_S = 0.008
"""Time between two joint positions of a sweep [s], as sent to a simulated controller."""

Say = Callable[[str], None]


def due_sweeps(run: RunFile) -> dict[int, list[PlannedSweep]]:
    """Return the planned sweeps that are not completely recorded yet, by stop."""
    done = {(state.arm, state.part_of or state.name) for state in recording_states(run) if state.reached_s is None}
    return grouped((sweep.stop, sweep) for sweep in read_sweeps(run) if (sweep.arm, sweep.name) not in done)


class Sweeps:
    """Planned sweeps of a run that are not recorded yet. ``note`` receives warnings for a person, ``tell`` the progress
    for whoever watches, with a sentence."""

    def __init__(
        self, run: RunFile, mover: Mover, session: int, note: Say, tell: Callable[[SweepLive, str], None]
    ) -> None:
        self._run, self._mover, self._note = run, mover, note
        self._tell: Callable[[SweepLive], None] = lambda live: tell(live, sweep_sentence(live))
        self._interval_s = 1.0 / run.profile.collection.motion_rate
        self._session = f"sweeps-{session}"
        self._waiting = due_sweeps(run)
        if self._waiting and mover.cell.record_sweep is None:
            why = why_no_sweeps(mover.cell, self._interval_s)
            if why:
                note(f"sweeps are left out: {why}; record the motion with your own programs and import it")
                self._waiting = {}

    @property
    def stops(self) -> tuple[int, ...]:
        """Stops with sweeps that remain to be recorded."""
        return tuple(self._waiting)

    def at_stop(self, stop: int, at: Mapping[str, Array], checkpoint: Callable[[], None]) -> Sequence[str]:
        """Sweep every arm about the positions ``at`` where all arms rest; return the names of the recorded arms.

        ``checkpoint`` raises if a halt of the cell or a person forbids further motion. A sweep that the gate refuses is
        left out with a note. On an exception, recordings so far are stored and the other sweeps remain to be done.
        """
        recorded: list[str] = []
        waiting = self._waiting.get(stop, [])
        while waiting:
            checkpoint()
            sweep = waiting[0]
            motions = self._motions(sweep, at)
            if reason := refuse_sweep(self._mover.bodies, motions, at, self._mover.cell.gate):
                self._note(f"stop {stop + 1}: the sweep of arm {sweep.arm} is left out: {reason}")
            elif self._record(sweep, motions, at):
                recorded.append(sweep.arm)
            waiting.pop(0)
        self._waiting.pop(stop, None)
        return recorded

    def leave_out(self, stop: int, reason: str) -> None:
        """Leave out the sweeps of a stop."""
        self._note(f"stop {stop + 1}: its sweeps are left out: {reason}")
        self._waiting.pop(stop, None)

    def _motions(self, sweep: PlannedSweep, at: Mapping[str, Array]) -> dict[str, Sweep]:
        """Return the planned motions of all moving arms, slowed down during a slow start."""
        speed = self._mover.speed
        planned = sweep.motions(at)
        return {name: replace(motion, period_s=motion.period_s / speed) for name, motion in planned.items()}

    def _record(self, sweep: PlannedSweep, motions: Mapping[str, Sweep], at: Mapping[str, Array]) -> bool:
        """Record one sweep about the stop ``at``; return whether anything was stored."""
        motion = motions[sweep.arm]
        live = SweepLive(sweep.stop, sweep.arm, sweep.name, duration_s=motion.period_s)
        self._tell(live)
        calculated = self._mover.cell.record_sweep
        if calculated is not None:
            paths = {name: its.at(its.times(CYCLE_S)) for name, its in motions.items()}
            own = paths.pop(sweep.arm)
            found = calculated(sweep.arm, own, CYCLE_S, paths)
            beside = self._beside(sweep, at, len(found.q), next(iter(found.beside_q.values()), None))
            joints = _joint_columns(found.joint_time_s, q=found.q, qd=found.qd, other_q=beside)
            points = _point_columns(found.point_time_s, found.p_M, found.sigma_m)
            store_recording(self._run, self._checked(sweep.arm, sweep.name, joints, points))
            self._tell(replace(live, state="done", done_s=live.duration_s))
            return True
        stored = 0
        for part in DrivenSweep(self._mover, self._interval_s, motions, self._note, self._tell, live).parts():
            beside = self._beside(sweep, at, len(part.joints.q), part.beside)
            stored += self._stored(sweep, replace(part, beside=beside))
        return stored > 0

    def _beside(self, sweep: PlannedSweep, at: Mapping[str, Array], n: int, swung: Array | None) -> Array | None:
        """Return the other arm's joint positions (n, K) [rad]; None if the other arm rests in all sweeps of the run.

        If it swings in some sweeps, its rest is given in the others: recordings of a session have the same columns.
        """
        if swung is not None or self._run.profile.plan.other_arm == "resting":
            return swung
        (resting,) = (q for name, q in at.items() if name != sweep.arm)
        return np.repeat(resting[None], n, axis=0)

    def _stored(self, sweep: PlannedSweep, part: SweepPart) -> bool:
        """Store a part of a sweep; return False, with a note, if its data are refused."""
        name, joints, track = self._free_name(sweep), part.joints, part.track
        temperature = joints.joint_temperature_c
        samples = _joint_columns(
            joints.time_s, q=joints.q, qd=joints.qd, joint_temperature=temperature, other_q=part.beside
        )
        points = _point_columns(track.device_time_s, track.p_M, track.sigma_m)
        try:
            recorded = self._checked(sweep.arm, name, samples, points)
        except InputError as error:
            self._note(f"stop {sweep.stop + 1}: a part of the sweep of arm {sweep.arm} is not kept: {error}")
            return False
        state = recorded.state.model_copy(update={"part_of": sweep.name, "reached_s": part.reached_s})
        store_recording(self._run, replace(recorded, state=state))
        missing = track.missing(self._interval_s)
        if joints.missing or missing:
            self._note(
                f"{name} of arm {sweep.arm}: {counted(joints.missing, 'sample')} of the joints and"
                f" {counted(missing, 'point')} did not come"
            )
        return True

    def _checked(
        self, arm: str, name: str, joints: Mapping[str, Array], points: Mapping[str, Array]
    ) -> RecordedStreams:
        """Check the columns of a recording. Raise ``InputError`` with what is not plausible."""
        where = Path(f"{name} of arm {arm}")
        samples, seen = (StreamTable(where, its, {}, np.arange(len(its["time_s"]))) for its in (joints, points))
        return checked_recording(self._run.profile, (arm, name), samples, seen, self._session)

    def _free_name(self, sweep: PlannedSweep) -> str:
        """Return an unused name for the next recording of a sweep."""
        taken = {state.name for state in recording_states(self._run) if state.arm == sweep.arm}
        names = (sweep.name, *(f"{sweep.name}.{number}" for number in range(2, len(taken) + 2)))
        return next(name for name in names if name not in taken)


def _joint_columns(time_s: Array, **tables: Array | None) -> dict[str, Array]:
    """Return the columns of a stream of joints from tables (n, N) by stem; a table is None if it was not recorded."""
    columns = {"time_s": time_s}
    for stem, table in tables.items():
        if table is not None:
            columns |= {f"{stem}{joint}": values for joint, values in enumerate(table.T, start=1)}
    return columns


def _point_columns(time_s: Array, p_M: Array, sigma_m: Array) -> dict[str, Array]:
    """Return the columns of a stream of points (n, 3); without uncertainties if one of them is unknown."""
    columns = {"time_s": time_s, **dict(zip(POINT, p_M.T, strict=True))}
    return {**columns, "sigma_m": sigma_m} if np.isfinite(sigma_m).all() else columns


INTERVAL_S = 0.01
"""Interval of points measured while the arm moves [s]: 1 mm at 100 mm/s."""
MOST_RUNS = 4
"""Maximum number of runs of a path: one, and another one after each break of the beam."""


def drive_path(
    mover: Mover,
    name: str,
    trajectory: Trajectory,
    begin: Callable[[], None],
    start_M: Array,
    interval_s: float = INTERVAL_S,
) -> PathTrack:
    """Let an arm follow a path, and measure its SMR every ``interval_s`` [s].

    ``begin`` moves the arm to the path's beginning, where its SMR is at ``start_M`` (3,) [m]. If the beam breaks, the
    arm slows down along the path and rests; its SMR is measured there, and the whole path is driven again. The tracker
    must be able to measure a moving SMR.

    Raises
    ------
    MotionRefused
        If the gate refuses.
    TargetLost, WrongTarget
        If the SMR is not seen at the beginning, or the beam broke in all ``MOST_RUNS`` runs.
    CellStopped
        As ``Mover.follow``, and if an SMR is not found again after a break of the beam.
    """
    streaming, follower, clock = stream_of(mover.cell.tracker), mover.cell.arms[name], mover.cell.clock
    assert streaming is not None
    assert isinstance(follower, PathFollower)
    for lost_beams in range(MOST_RUNS):
        begin()
        beam = Beam([follower], mover.reaction)
        streaming.start_track(start_M, interval_s, beam.lost)
        began_s = clock.now_s()
        try:
            mover.follow({name: (trajectory.q, trajectory.period_s)})
        except BaseException:
            with suppress(TrackerError):  # report why the arm did not reach the end, not this
                streaming.end_track()
            raise
        track = streaming.end_track()
        if beam.error is None:
            track = track.within((track.time_s >= began_s) & (track.time_s <= began_s + trajectory.duration_s))
            return PathTrack(track.time_s, track.p_M, lost_beams)
        try:
            find_again(mover, name)
        except (TargetLost, WrongTarget) as error:
            text = f"arm {name}: the beam broke while it followed a path, and its SMR is not found again: {error}; look"
            raise mover.stop_cell(StopCause("tracker", f"{text} for what covers it, then begin again", name)) from error
    raise TargetLost(
        f"arm {name}: the beam broke each of the {counted(MOST_RUNS, 'time')} that this path was driven; it is not"
        " measured. Look for what crosses the beam along it"
    )
