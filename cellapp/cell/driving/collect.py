"""The verb ``collect``: drive to the stops, measure the SMRs at each, commit every stop before the next motion.

One collecting session in an open cell: visit the stops, measure, store; pause when the cell or a person asks.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from cellapp.cell.driving.cell import Cell, open_cell
from cellapp.cell.driving.cell_checks import Hung, change_load, check_controllers, other_loads, require_load
from cellapp.cell.driving.diagnosis import require_links
from cellapp.cell.driving.live_model import AirTemperature, LiveModel
from cellapp.cell.driving.measuring import References, measured_at_arm
from cellapp.cell.driving.motion import Confirm, MotionRefused, Mover, PointAtRest, point_measured, reading_of
from cellapp.cell.driving.reaction import CellStopped, StopCause
from cellapp.cell.driving.records import CollectResult, End
from cellapp.cell.driving.stops_to_collect import StopQueue, StopsToCollect, Travel, remaining_work, work_again
from cellapp.cell.driving.supervision import CellSupervisor, reacting
from cellapp.cell.driving.sweeping import Sweeps, due_sweeps
from cellapp.cell.planning.planned_stops import planned_time, tell_time
from cellapp.cell.run import Outcome, RunFile, SessionEnd
from cellapp.cell.run.measured_again import (
    missing_readings,
    missing_share,
    reference_drifts,
    replace_stop,
    replaced_counts,
)
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.estimation.readings import Readings
from cellapp.ground.control import Aborted, JobControl, Stopped
from cellapp.ground.counting import counted
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Detail, LogReport, MeasurementBegun, PointMissed, Suspicion
from drivers.arms.protocol import ArmError, ArmState
from drivers.plant import Plant
from drivers.trackers.protocol import TargetLost, TrackerError, Unstable, WrongTarget

MOST_MISSED_IN_A_ROW = 10
"""Consecutive stops without a reading that mean a fault of tracker or targets: all planned stops are visible."""

_READING_BYTES, _STOP_BYTES, _LOG_BYTES, _SWEEP_BYTES_S = 2048, 65_536, 4_194_304, 200_000
"""Upper limits of what a reading adds to a run file, of its write-ahead log by a stop and in all, and of what a second
of a sweep adds."""
_HARMLESS = ("pause", "resume", "suspend", "give up", "reference")
"""Kinds of recorded requests that need nobody's attention afterwards; all others are logged as warnings."""

T = TypeVar("T")


@dataclass
class CollectSession:
    """Collects the remaining stops of a run with the devices of an open cell.

    The profile of ``mover`` is the run's, with the payloads that the arms carry at these stops. ``number`` is that of
    the session in the run. If ``accept_drift``, drift is relative to the first reference measurements of this session.
    ``confirm`` is called once, before the first motion.
    """

    run: RunFile
    work: StopsToCollect
    mover: Mover
    number: int
    accept_drift: bool = False
    confirm: Confirm | None = None
    notes: list[str] = field(default_factory=list)
    began_s: float | None = None
    """Start of the run on the cell's clock [s]; the controllers' own clocks are not used."""

    def __post_init__(self) -> None:
        profile, cell = self.mover.profile, self.mover.cell
        self.mover.emit = self._emit
        self._settings = profile.collection
        self._is_loaded = profile.loads > 1  # then each reading states its payload, and collecting never ends early
        self._queue = StopQueue(self.work)
        self._supervisor = CellSupervisor(self.mover, self._record, self._after_resume)
        self._references = References(
            self.run,
            self.number,
            self._supervisor,
            self._suspect,
            self.accept_drift,
            other_loads(self.run.profile, profile),
        )
        self._air = None if cell.air is None else AirTemperature(cell.air, self._log, self._emit)
        stored = {name: self.run.readings(name) for name in self.work.route.q}
        if self.work.again:  # leave out the stops to be measured again: the model judges them anew
            stored = {name: its.take(~np.isin(its.configuration, self.work.stops)) for name, its in stored.items()}
        self.model = LiveModel(profile, self.work.route.q, stored, self._log)
        self._sweeps = Sweeps(self.run, self.mover, self.number, self._note, self._emit)
        self._travel = Travel(self.mover, self.work)
        self._forbidden: set[int] = set()
        self._warm_until_s: float | None = None
        self._missed = 0
        self._until_reference = 0

    # -- the session ---------------------------------------------------------------------------------------------------

    def collect(self) -> End:
        """Visit all stops of the queue; return how the session ended.

        Raises
        ------
        HardwareError
            If a person is needed and nobody attends the job.
        Stopped, Aborted
        InputError
            If the run file cannot be written.
        """
        self._with_recovery(self._wait_for_tracker)
        self._with_recovery(self._leave_out_forbidden_stops)
        if self._queue.next() is None and not self._sweeps.stops:
            return "complete"
        self._with_recovery(self._confirm_first_motion)
        self._with_recovery(self._warm_up)
        end: End = "complete"
        while (stop := self._queue.next()) is not None:
            self._emit(note=f"stop {stop + 1}")
            self._with_recovery(self._measure_references)
            accurate = self._with_recovery(self._visit_next)
            if self._queue.next() != stop and stop in self.run.stops_done():  # neither deferred nor left out
                self._with_recovery(partial(self._sweep, stop))
            if accurate:
                end = "accurate enough"
                break
        else:
            for stop in () if self.work.again else self._sweeps.stops:  # left over from an earlier session
                self._with_recovery(partial(self._sweep, stop))
        self._queue.close()
        self._until_reference = 0
        self._with_recovery(self._measure_references)
        self._emit(note="going home")
        self._with_recovery(self._end_at_home)
        return end

    def _with_recovery(self, act: Callable[[], T]) -> T:
        """Call ``act``; after a halt from which the cell recovers, call it again from its beginning."""
        while True:
            try:
                self._supervisor.checkpoint()
                return act()
            except CellStopped as stopped:
                self._supervisor.recover(stopped)
            except TrackerError as error:
                self.mover.reaction.trigger(StopCause("tracker", str(error)))
                self._supervisor.recover(CellStopped(self.mover.reaction.cause or StopCause("tracker", str(error))))

    def _after_resume(self) -> None:
        """Restart slowly and without suspicions: a person may have been in the cell, or changed something in it."""
        self._travel.slow_again()
        self.model.forget_suspicions()

    def _visit_next(self) -> bool:
        """Move to the next stop, measure and store; return whether the requested accuracy is reached."""
        stop = self._queue.next()
        assert stop is not None
        self._wait_for_air(stop)
        self.mover.stop = stop
        try:
            states = self._travel.to_stop(stop)
        except MotionRefused as error:
            if stop in self.work.proposed or not self._queue.defer():
                self._leave_out({stop}, str(error))
            return False
        finally:
            self.mover.stop = None
        rows, outcomes = self._measure(stop, states)
        self._store(stop, rows, outcomes)
        self._queue.done()
        if outcomes and self._queue.replace() is not None:  # stops that are measured again have no reserve stops
            self._log("info", f"stop {stop + 1}: a reserve stop takes its place")
        self._travel.stop_visited()
        self._until_reference -= 1
        self._report(stop, rows)
        self._check_missed(rows)
        return not (self.work.again or self._is_loaded) and self.model.accurate_enough(self._queue.finished)

    def _sweep(self, stop: int) -> None:
        """Record the remaining sweeps about a stop, with the arms at rest there; skip stops that were left out."""
        if stop not in self._sweeps.stops or stop in self._forbidden:
            return
        at = self.work.route.targets(stop)
        try:
            if not self.mover.rests_at(at):
                self._travel.to_stop(stop)
            recorded = self._sweeps.at_stop(stop, at, self._supervisor.checkpoint)
        except (MotionRefused, TargetLost, WrongTarget) as error:
            self._sweeps.leave_out(stop, str(error))
        else:
            self._emit(note=f"stop {stop + 1}: sweeps of {' and '.join(recorded) or 'no arm'} are recorded")

    def _report(self, stop: int, rows: Mapping[str, Readings]) -> None:
        """Refit the running model and report what it shows; log suspicions."""
        for detail in self.model.add(stop, rows):
            if isinstance(detail, Suspicion):
                self._suspect(detail)
            else:
                self._emit(detail)

    def _suspect(self, suspicion: Suspicion) -> None:
        self._emit(suspicion)
        self._note(f"after {counted(self._queue.finished, 'stop')}: {suspicion.kind}: {suspicion.text}")

    def _check_missed(self, rows: Mapping[str, Readings]) -> None:
        """Pause after too many consecutive stops without a reading; raise ``HardwareError`` if nobody attends."""
        self._missed = 0 if rows else self._missed + 1
        if self._missed < MOST_MISSED_IN_A_ROW:
            return
        text = f"the tracker saw no SMR at {counted(self._missed, 'stop')} in a row; check tracker and targets"
        if not self._supervisor.hold(text):
            raise HardwareError(text)
        self._missed = 0

    # -- before and between stops --------------------------------------------------------------------------------------

    def _wait_for_tracker(self) -> None:
        """Wait, as long as the profile allows, for a tracker that was not ready when the cell was opened."""
        if not self.mover.cell.tracker_unmet:
            return
        text = "; ".join(self.mover.cell.tracker_unmet)
        if not self._supervisor.suspended("tracker_warm_up", text, self._supervisor.tracker_ready):
            self.mover.cell.require_tracker()

    def _leave_out_forbidden_stops(self) -> None:
        """Ask every controller, before anything moves, which stops it forbids; leave those out."""
        forbidden = self._travel.forbidden_stops()
        self._forbidden = set(forbidden)
        for stop, reason in forbidden.items():
            self._leave_out({stop}, reason)
            self._queue.replace()

    def _confirm_first_motion(self) -> None:
        """Let a person confirm the first motion."""
        first = self._queue.next()
        homes = self.mover.homes
        if self._settings.warm_up > 0.0:
            first = next(iter(self._allowed_stops()), first)
        elif self._settings.reference.every > 0:
            first = self._reference_stop() if self.mover.rests_at(homes) else None
        self.mover.confirm_first(homes if first is None else self._travel.first_leg(first), self.confirm)

    def _allowed_stops(self) -> list[int]:
        """Return the stops that are not stored yet and that no controller forbids."""
        return [stop for stop in self.work.stops if stop not in self._forbidden]

    def _warm_up(self) -> None:
        """Exercise the arms along the first planned stops for the profile's warm-up time."""
        if self._warm_until_s is None:
            self._warm_until_s = self.mover.cell.clock.now_s() + self._settings.warm_up
        stops = self._allowed_stops()
        while self.mover.cell.clock.now_s() < self._warm_until_s and stops:
            for stop in stops:
                remaining_s = self._warm_until_s - self.mover.cell.clock.now_s()
                if remaining_s <= 0.0:
                    break
                self._emit(note=f"warming up, {remaining_s / 60.0:.0f} min left")
                self._supervisor.checkpoint()
                with suppress(MotionRefused):  # the next stop may be reachable
                    self._travel.to_stop(stop)
        if self._settings.warm_up > 0.0:
            self._travel.home()

    def _reference_stop(self) -> int:
        """Return the first stop of the plan that no controller forbids: the same one in every session."""
        return next(stop for stop in range(len(self.work.route)) if stop not in self._forbidden)

    def _measure_references(self) -> None:
        """Measure the references if they are due: the SMRs at the reference stop, and fixed nests."""
        every = self._settings.reference.every
        if every == 0 or self._until_reference > 0:
            return
        self._emit(note="reference measurements")
        self._until_reference = every
        try:
            self._travel.home()  # approach from the same side each time: joint hysteresis must not look like drift
            states = self._travel.to_stop(self._reference_stop())
        except MotionRefused as error:
            self._note(f"after {counted(self._queue.finished, 'stop')}: no reference measurements: {error}")
            return
        began_s = self._begin(self.mover.cell.clock.now_s())
        self._until_reference = 0  # until the measurements are complete: after a halt they are repeated
        positions = {name: state.q for name, state in states.items()}
        report = self._references.check(positions, self._queue.finished, began_s)
        self._until_reference = every
        self._emit(report)

    def _wait_for_air(self, stop: int) -> None:
        """Suspend while the air temperature is out of the profile's limits; raise ``HardwareError`` if it stays so."""
        limits = self._settings.air.temperature
        if limits is None or self._air is None:
            return
        air = self._air
        latest = air.at_stop(stop)

        def out_of_limits(temperature_c: float | None) -> bool:
            return temperature_c is not None and not limits[0] <= temperature_c <= limits[1]

        if not out_of_limits(latest):
            return
        text = f"air at {latest:.1f} degC, allowed are {limits[0]:g} to {limits[1]:g}"
        if self._supervisor.suspended("air", text, lambda: not out_of_limits(air.at_stop(stop))):
            return
        if not self._supervisor.hold(text):
            raise HardwareError(f"{text}; continue with --resume when it has settled")

    def _end_at_home(self) -> None:
        """Move all arms home."""
        try:
            self._travel.home_at_once()
        except MotionRefused as error:
            self.notes.append(f"the arms stay where they are: {error}")

    # -- measurement ---------------------------------------------------------------------------------------------------

    def _measure(self, stop: int, states: Mapping[str, ArmState]) -> tuple[dict[str, Readings], list[Outcome]]:
        """Measure the arms in the order of their dwell times.

        Return the readings of their SMRs, and an outcome for each SMR that was not measured.
        """
        temperature_c = None if self._air is None else self._air.at_stop(stop)
        rows: dict[str, Readings] = {}
        outcomes: list[Outcome] = []
        dwell_s = {name: self.work.dwell_s(stop, name) for name in states}
        for name in sorted(states, key=lambda name: dwell_s[name]):
            if dwell_s[name] > 0.0:
                self.mover.rest(name, dwell_s[name])
            self._emit(MeasurementBegun(stop, name))
            try:
                point = measured_at_arm(self._supervisor, name, states[name].q)
            except (TargetLost, WrongTarget, Unstable) as error:
                outcomes.append(Outcome(stop, name, "not measured", str(error)))
                self._emit(PointMissed(stop, name, str(error)))
                self._note(f"stop {stop + 1}, arm {name}: not measured: {error}")
                continue
            air_c = point.temperature_c if self._air is None else temperature_c
            rows[name] = self._reading(name, states[name], point, air_c)
            self._emit(point_measured(stop, name, rows[name]))
        return rows, outcomes

    def _reading(self, name: str, state: ArmState, point: PointAtRest, temperature_c: float | None) -> Readings:
        """Return the reading of a point just measured; its dwell time lasts until the middle of the averaging."""
        carried, payload_kg = self.mover.profile.arms[name].payload, state.payload_kg
        return reading_of(
            point,
            self.mover.conditions(name, state, -0.5 * point.averaging_s),
            time_s=point.time_s - self._begin(point.time_s - point.averaging_s),
            payload_kg=carried.mass if payload_kg is None and self._is_loaded else payload_kg,
            payload_center_F=np.array(carried.center_of_mass) if self._is_loaded else None,
            temperature_c=temperature_c,
            split=self.work.split,
        )

    def _begin(self, now_s: float) -> float:
        """Return the start of the run on the cell's clock [s]; the first call sets it."""
        if self.began_s is None:
            self.began_s = now_s - self.work.earlier_s
        return self.began_s

    def _store(self, stop: int, rows: Mapping[str, Readings], outcomes: list[Outcome]) -> None:
        """Store a stop; if writing fails, pause so that a person can free the disk, then try again."""
        while True:
            try:
                if self.work.again:
                    replace_stop(self.run, stop, rows, outcomes)
                else:
                    self.run.add_stop(stop, rows, outcomes)
                return
            except InputError as error:
                if not self._supervisor.hold(str(error)):
                    raise

    def _leave_out(self, stops: set[int], reason: str) -> None:
        for stop in sorted(stops):
            self._store(stop, {}, [Outcome(stop, name, "left out", reason) for name in self.work.route.q])
            self._note(f"stop {stop + 1}: left out: {reason}")
        self._queue.remove(stops)

    # -- what others hear ----------------------------------------------------------------------------------------------

    def _emit(self, detail: Detail | None = None, note: str = "") -> None:
        self.mover.cell.pulse.beat()
        self.mover.control.tell("collect", self._queue.finished, self._queue.total, note, detail=detail)

    def _record(self, kind: str, reason: str) -> None:
        """Record a request or a suspension in the run; if writing fails, note it: the arms still need attention."""
        text = f"{kind}: {reason}"
        level = "info" if kind in _HARMLESS else "warning"
        if kind == "reference":  # any other kind tells a new state of the job
            self._emit(LogReport(level, text))
        try:
            self.run.record_request(self.number, kind, reason)
            self.run.log(level, text, self._run_time_s())
        except InputError as error:
            self.notes.append(f"{text} (not logged: {error})")

    def _note(self, text: str) -> None:
        self._log("warning", text)

    def _log(self, level: str, text: str) -> None:
        self.run.log(level, text, self._run_time_s())
        self._emit(LogReport(level, text))
        if level == "warning":
            self.notes.append(text)

    def _run_time_s(self) -> float | None:
        """Return the time since the run began [s], on the clock of the readings; None before the first measurement."""
        return None if self.began_s is None else self.mover.cell.clock.now_s() - self.began_s


def collect_run(
    run: RunFile,
    control: JobControl | None = None,
    *,
    resume: bool = False,
    accept_drift: bool = False,
    again: Collection[int] | None = None,
    confirm: Confirm | None = None,
    payload: Mapping[str, float] | None = None,
    hung: Hung | None = None,
) -> CollectResult:
    """Collect all planned stops that are not stored yet.

    If an SMR cannot be measured, this is recorded and its arm has no reading; the stop counts as done for the other
    arm, and a reserve stop is added. Every stop is reached as planned, with its own approach and dwell. If the gate
    refuses all ways to a stop, it is tried again at the end, then left out; one that discovery proposed is left out at
    once. Once splits are sampled, new readings are for training: the validation set must not change.

    With ``again`` only those stops are visited, as planned. Their new readings replace the earlier ones, which are kept
    as replaced; an arm without a new reading keeps its earlier one.

    Stops with another load are collected in a session of their own, with the cell opened anew, after ``hung`` was
    called. ``payload`` is what the arms carry now according to a person [kg].

    Raises
    ------
    InputError
        If there is no plan, stops are stored and ``resume`` is False, a stop of ``again`` was not tried yet, the first
        motion is not confirmed, ``payload`` is not the load that comes next, or the run file cannot be written.
    HardwareError
        If an arm or the tracker fails, or nothing could be measured; all committed stops stay.
    Stopped, Aborted
        On request, or if nobody attaches the next load; the arms have been braked, and the run can be resumed.
    """
    control = control or JobControl()
    work = work_again(run, again) if again is not None else remaining_work(run, resume=resume)
    if not work.stops and not (again is None and due_sweeps(run)):
        return _collected(run, "complete", [f"all {counted(work.total, 'stop was', 'stops were')} stored already"])
    _require_space(run, work)
    require_links(run.profile, control.check)
    sweeps_s = 0.0 if work.again else sum(one.period_s for one in chain(*due_sweeps(run).values()))
    planned_s = planned_time(run.profile, work.route.take(work.stops)).total_s if work.stops else 0.0
    tell_time(control, "collect", run.profile, planned_s + sweeps_s, work.stored, work.total)
    before = replaced_counts(run)
    sessions = _Sessions(run, control, accept_drift, confirm)
    for load in work.loads or (0,):
        profile = change_load(run, load, payload, hung)
        payload = None  # it describes the first load only
        work_here = work if work.again or run.profile.loads == 1 else remaining_work(run, resume=True)
        outcome = sessions.collect(profile, work_here.with_load(load))
    result = _collected(run, outcome, sessions.notes, sessions.standard_error_mm)
    if not work.again:
        return result
    replaced = sum(replaced_counts(run).values()) - sum(before.values())
    return result.model_copy(update={"replaced": replaced, "notes": (*result.notes, *_held_out_notes(run, work))})


def _require_space(run: RunFile, work: StopsToCollect) -> None:
    """Raise ``InputError`` unless all that remains to be collected can be written; nothing has moved."""
    stops, sweeps = (len(work.stops) + len(work.reserves), [] if work.again else [*chain(*due_sweeps(run).values())])
    readings = stops * len(work.route.q)
    needed = min(stops * _STOP_BYTES, _LOG_BYTES) + readings * _READING_BYTES
    needed += round(sum(sweep.period_s for sweep in sweeps) * _SWEEP_BYTES_S)
    swept = f" and {counted(len(sweeps), 'sweep')}" if sweeps else ""
    run.require_space(needed, f"collecting {counted(stops, 'stop')}{swept}")


@dataclass
class _Sessions:
    """Consecutive sessions of a run, one per load; a simulated cell keeps its state from one to the next."""

    run: RunFile
    control: JobControl
    accept_drift: bool
    confirm: Confirm | None
    notes: list[str] = field(default_factory=list)
    standard_error_mm: Mapping[str, float] = field(default_factory=dict)
    plant: Plant | None = None
    began_s: float | None = None

    def collect(self, profile: Profile, work: StopsToCollect) -> End:
        """Collect stops with the load of the profile. Raise as ``collect_run``."""
        run, control, notes = self.run, self.control, self.notes
        bodies = cell_bodies(profile)
        if profile.plant is not None:
            profile = profile.model_copy(update={"plant": profile.plant.after(len(run.sessions()))})
        with open_cell(profile, plant=self.plant, control=control) as cell:
            self.plant = cell.plant
            if run.profile.loads > 1:
                require_load(cell, profile)
            notes += [note for note in check_controllers(run, cell) if note not in notes]
            number = run.begin_session(", ".join(str(stop + 1) for stop in work.stops) if work.again else "")
            with (
                _session_recorded(run, number),
                _late_heartbeats_noted(run, cell, notes),
                reacting(cell, control) as reaction,
            ):
                session = CollectSession(
                    run=run,
                    work=work,
                    mover=Mover(profile, cell, bodies, reaction, control),
                    number=number,
                    accept_drift=self.accept_drift,
                    confirm=self.confirm,
                    notes=notes,
                    began_s=self.began_s,
                )
                outcome = session.collect()
                if not run.stops_done():
                    reason = next((one.reason for one in run.outcomes()), "no stop could be visited")
                    raise HardwareError(f"nothing could be measured: {reason}")
                run.end_session(number, outcome, "")
            self.began_s = session.began_s
        self.standard_error_mm = session.model.standard_error_mm
        return outcome


def _collected(
    run: RunFile, outcome: End, notes: Sequence[str], standard_error_mm: Mapping[str, float] = MappingProxyType({})
) -> CollectResult:
    missing = missing_readings(run)
    return CollectResult(
        stops=len(run.stops_done()),
        notes=tuple(notes),
        outcome=outcome,
        missing=missing,
        missing_share=missing_share(run, missing),
        tolerated_share=run.profile.collection.tolerated,
        references=reference_drifts(run),
        standard_error_mm=standard_error_mm,
    )


def _held_out_notes(run: RunFile, work: StopsToCollect) -> list[str]:
    """Return a note if readings of the validation set were measured again: their errors may then come out too small."""
    held_out = {
        int(stop)
        for readings in map(run.readings, run.arms())
        for stop in readings.configuration[readings.in_split("validate")]
    }
    chosen = len(held_out & set(work.stops))
    if not chosen:
        return []
    return [
        f"{counted(chosen, 'of these stops is', 'of these stops are')} held out for validation: if only those were"
        " measured again that looked bad, the errors at held-out stops come out too small"
    ]


@contextmanager
def _late_heartbeats_noted(run: RunFile, cell: Cell, notes: list[str]) -> Iterator[None]:
    """Note warnings that drivers raised in the meantime, as of late heartbeats, however the session ends."""
    try:
        yield
    finally:
        with suppress(ArmError, InputError):  # report how the session ended, not this
            for text in (text for arm in cell.arms.values() for text in arm.warnings()):
                if text not in notes:
                    notes.append(text)
                    run.log("warning", text)


@contextmanager
def _session_recorded(run: RunFile, number: int) -> Iterator[None]:
    """Record how a session ends with an exception and raise that again, even if recording fails."""
    endings: tuple[tuple[type[BaseException], SessionEnd], ...] = ((Aborted, "aborted"), (Stopped, "stopped"))
    try:
        yield
    except BaseException as error:
        outcome: SessionEnd = next((word for kind, word in endings if isinstance(error, kind)), "failed")
        with suppress(InputError):
            run.end_session(number, outcome, str(error))
            run.log("info" if outcome != "failed" else "error", f"collecting {outcome}: {error}")
        raise
