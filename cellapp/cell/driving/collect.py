"""The verb ``collect``: drive to the stops, measure the SMRs at each, commit every stop before the next motion."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType

from cellapp.cell.driving.cell import Cell, open_cell
from cellapp.cell.driving.controllers import check_controllers
from cellapp.cell.driving.loads import Hung, change_load, require_load
from cellapp.cell.driving.motion import Confirm
from cellapp.cell.driving.records import CollectResult, End
from cellapp.cell.driving.session import CollectSession
from cellapp.cell.driving.supervision import Opened, opening, reacting
from cellapp.cell.driving.sweeping import sweeps_left
from cellapp.cell.driving.work import Work, remaining_work, work_again
from cellapp.cell.run import RunFile, SessionEnd
from cellapp.cell.run.collected import missing_readings, missing_share, reference_drifts
from cellapp.cell.run.measured_again import replaced_counts
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.ground.control import Aborted, JobControl, Stopped
from cellapp.ground.counting import counted
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Listener, ignore
from drivers.arms.protocol import ArmError
from drivers.plant import Plant


def collect_run(
    run: RunFile,
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    resume: bool = False,
    accept_drift: bool = False,
    again: Collection[int] | None = None,
    watch_clearance: bool = False,
    confirm: Confirm | None = None,
    opened: Opened | None = None,
    payload: Mapping[str, float] | None = None,
    hung: Hung | None = None,
) -> CollectResult:
    """Collect all planned stops that are not stored yet.

    If an SMR cannot be measured, this is recorded and its arm has no reading; the stop counts as done for the other
    arm, and a reserve stop is added. Every stop is reached as planned, with its own approach and dwell. If the gate
    refuses all ways to a stop, it is tried again at the end, then left out; one that discovery proposed is left out at
    once. Once splits are drawn, new readings are for training: the validation set must not change.

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
    if not work.stops and not (again is None and sweeps_left(run)):
        return _collected(run, "complete", [f"all {counted(work.total, 'stop was', 'stops were')} stored already"])
    before = replaced_counts(run)
    sessions = _Sessions(run, listener, control, accept_drift, confirm, opened, watch_clearance)
    for load in work.loads or (0,):
        profile = change_load(run, load, payload, hung)
        payload = None  # it describes the first load only
        left = work if work.again or run.profile.loads == 1 else remaining_work(run, resume=True)
        outcome = sessions.collect(profile, left.with_load(load))
    result = _collected(run, outcome, sessions.notes, sessions.standard_error_mm)
    if not work.again:
        return result
    replaced = sum(replaced_counts(run).values()) - sum(before.values())
    return result.model_copy(update={"replaced": replaced, "notes": (*result.notes, *_held_out_notes(run, work))})


@dataclass
class _Sessions:
    """Consecutive sessions of a run, one per load; a simulated cell keeps its state from one to the next."""

    run: RunFile
    listener: Listener
    control: JobControl
    accept_drift: bool
    confirm: Confirm | None
    opened: Opened | None
    watch_clearance: bool
    notes: list[str] = field(default_factory=list)
    standard_error_mm: Mapping[str, float] = field(default_factory=dict)
    plant: Plant | None = None
    began_s: float | None = None
    ended_s: float = math.inf
    """End of the last session on the clock of its cell [s]."""

    def collect(self, profile: Profile, work: Work) -> End:
        """Collect stops with the load of the profile. Raise as ``collect_run``."""
        run, control, notes, opened = self.run, self.control, self.notes, self.opened
        bodies = cell_bodies(profile)
        if opened is None and self.plant is not None:
            opened = partial(open_cell, plant=self.plant, control=control)
        with opening(profile, control, opened, watch_clearance=self.watch_clearance) as cell:
            self.plant = cell.plant
            if run.profile.loads > 1:
                require_load(cell, profile)
            notes += [note for note in check_controllers(run, cell).notes if note not in notes]
            number = run.begin_session(", ".join(str(stop + 1) for stop in work.stops) if work.again else "")
            with (
                _session_recorded(run, number),
                _late_heartbeats_noted(run, cell, notes),
                reacting(cell, control) as reaction,
            ):
                session = CollectSession(
                    run=run,
                    profile=profile,
                    work=work,
                    cell=cell,
                    bodies=bodies,
                    reaction=reaction,
                    control=control,
                    listener=self.listener,
                    number=number,
                    accept_drift=self.accept_drift,
                    confirm=self.confirm,
                    notes=notes,
                    began_s=self.began_s if cell.clock.now_s() >= self.ended_s else None,
                )
                outcome = session.collect()
                if not run.stops_done():
                    reason = next((one.reason for one in run.outcomes()), "no stop could be visited")
                    raise HardwareError(f"nothing could be measured: {reason}")
                run.end_session(number, outcome, "")
            self.began_s, self.ended_s = session.began_s, cell.clock.now_s()
        self.standard_error_mm = session.standard_error_mm
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


def _held_out_notes(run: RunFile, work: Work) -> list[str]:
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
