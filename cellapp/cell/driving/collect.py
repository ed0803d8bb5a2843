"""The verb: drive the planned stops, measure both SMRs at each, and commit every stop before the next motion."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from types import MappingProxyType

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.controllers import check_controllers
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
from cellapp.ground.progress import Listener, ignore
from drivers.arms.protocol import ArmError


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
) -> CollectResult:
    """Collect all planned stops that are not stored yet.

    A target that cannot be measured is recorded and its arm's reading left out; the stop counts as done for the other
    arm, and a reserve stop is added. Every stop is reached as planned, with its own approach and dwell. If the gate
    refuses all ways to it, it is tried again at the end, then left out; one that discovery proposed is left out at
    once. Once splits are drawn, new readings are for training: the validation set must not change.

    With ``again`` only those stops are visited, as planned. Their new readings count, those before are kept beside, and
    an arm that gives none keeps what it has.

    Raises
    ------
    InputError
        If there is no plan, stops are stored and ``resume`` is False, a stop of ``again`` was not tried yet, the first
        motion is not confirmed, or the run file cannot be written.
    HardwareError
        If an arm or the tracker fails, or nothing could be measured; all committed stops stay.
    Stopped, Aborted
        On request; the arms have been braked, and the run can be resumed.
    """
    control = control or JobControl()
    work = work_again(run, again) if again is not None else remaining_work(run, resume=resume)
    if not work.stops and not (again is None and sweeps_left(run)):
        return _collected(run, "complete", [f"all {counted(work.total, 'stop was', 'stops were')} stored already"])
    bodies, before = cell_bodies(run.profile), replaced_counts(run)
    with opening(run.profile, control, opened, watch_clearance=watch_clearance) as cell:
        notes = list(check_controllers(run, cell).notes)
        number = run.begin_session(", ".join(str(stop + 1) for stop in work.stops) if work.again else "")
        with (
            _session_recorded(run, number),
            _late_heartbeats_noted(run, cell, notes),
            reacting(cell, control) as reaction,
        ):
            session = CollectSession(
                run, work, cell, bodies, reaction, control, listener, number, accept_drift, confirm, notes
            )
            outcome = session.collect()
            if not run.stops_done():
                reason = next((one.reason for one in run.outcomes()), "no stop could be visited")
                raise HardwareError(f"nothing could be measured: {reason}")
            run.end_session(number, outcome, "")
    result = _collected(run, outcome, notes, session.standard_error_mm)
    if not work.again:
        return result
    replaced = sum(replaced_counts(run).values()) - sum(before.values())
    return result.model_copy(update={"replaced": replaced, "notes": (*result.notes, *_held_out_notes(run, work))})


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
    """That chosen readings of the validation set were measured again: this may flatter the errors that it shows."""
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
    """Note the warnings that drivers have gained meanwhile, as of late heartbeats, however the session ends."""
    try:
        yield
    finally:
        with suppress(ArmError, InputError):  # the session's own end is the one to report
            for text in (text for arm in cell.arms.values() for text in arm.warnings()):
                if text not in notes:
                    notes.append(text)
                    run.log("warning", text)


@contextmanager
def _session_recorded(run: RunFile, number: int) -> Iterator[None]:
    """Record how a session ends with an exception; the exception is the one to report, whatever the disk says."""
    endings: tuple[tuple[type[BaseException], SessionEnd], ...] = ((Aborted, "aborted"), (Stopped, "stopped"))
    try:
        yield
    except BaseException as error:
        outcome: SessionEnd = next((word for kind, word in endings if isinstance(error, kind)), "failed")
        with suppress(InputError):
            run.end_session(number, outcome, str(error))
            run.log("info" if outcome != "failed" else "error", f"collecting {outcome}: {error}")
        raise
