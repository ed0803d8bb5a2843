"""What the screen Collect says in large letters: the state, and what can be done now. Draws nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cellapp.ground.control import Request
from cellapp.ground.counting import counted
from cellapp.ground.progress import JobState
from cellapp.interfaces.tui.job_record import JobRecord, within_limit
from cellapp.interfaces.tui.workspace import NO_PROFILE, NO_RUN, Workspace

Look = Literal["idle", "running", "waiting", "halted", "replay", "done"]

_DOING: dict[JobState, tuple[Look, str]] = {
    "running": ("running", "Escape brakes all arms; p pauses after this stop; x ends it."),
    "pausing": ("waiting", "The arms rest after this stop. p or c resumes; Escape brakes."),
    "paused": ("waiting", "The arms rest. p or c resumes; Escape stops; x ends it."),
    "suspended": ("waiting", "It resumes by itself once the cause is gone. Escape stops; x ends it."),
    "stopped": ("halted", "c resumes when the cell is clear; x ends it."),
    "aborted": ("halted", "The arms brake and the job ends; what was measured is kept."),
}


@dataclass(frozen=True)
class Headline:
    """A word, a sentence with what can be done, and how they look."""

    word: str
    sentence: str
    look: Look


def stops_left(workspace: Workspace) -> int:
    """Number of stops that are neither measured nor in reserve."""
    if workspace.stops is None or workspace.profile is None:
        return 0
    stops = workspace.stops.stops
    reserves = workspace.profile.plan.reserves(len(stops))
    return sum(not stop.measured and stop.configuration not in reserves for stop in stops)


def stops_measured(workspace: Workspace) -> int:
    """Number of stops that were measured."""
    return 0 if workspace.stops is None else sum(stop.measured for stop in workspace.stops.stops)


def drift_exceeded(workspace: Workspace) -> bool:
    """Whether the newest reference measurements of the run are beyond the limit."""
    collection = workspace.collection
    if collection is None or not collection.references:
        return False
    newest = collection.references[-1].stops_done
    return any(row.stops_done == newest and row.drift_mm > collection.drift_limit_mm for row in collection.references)


def holds_for_drift(record: JobRecord) -> bool:
    """Whether the job was stopped by references beyond their limit."""
    newest = record.references[-1] if record.references else None
    by_reference = record.reason.startswith("reference ")
    return record.state == "stopped" and by_reference and (newest is None or not within_limit(newest))


def headline(workspace: Workspace, record: JobRecord, request: Request) -> Headline:
    """The state of the job, else of the run; ``request`` is what a person asked of the job."""
    if record.state is None:
        return _of_run(workspace)
    if record.is_replay:
        return _of_replay(record, record.state, request)
    state = record.state
    if state in ("running", "pausing") and record.causes:  # the job's thread has not noticed yet, or hangs
        return Headline("STOPPED", f"{'; '.join(record.causes).rstrip('.')}. {_DOING['stopped'][1]}", "halted")
    if record.lost and state != "stopped":  # a stopped job says why, and what a person may do; the strip shows the ages
        text = f"from {', '.join(record.lost)}: what is shown of it is old. Escape brakes all arms."
        return Headline("NO DATA", text, "halted")
    if state == "running" and request != "none":
        state = {"pause": "pausing", "stop": "stopped", "abort": "aborted"}[request]  # type: ignore[assignment]
    look, possible = _DOING[state]
    if holds_for_drift(record):
        possible = "Look for a moved tracker, nest or SMR. a accepts the drift and resumes, as c does; x ends it."
    shows_reason = record.reason and state == record.state != "running"
    return Headline(state.upper(), f"{record.reason.rstrip('.')}. {possible}" if shows_reason else possible, look)


def _of_replay(record: JobRecord, state: JobState, request: Request) -> Headline:
    """A replay; the states that it plays back are those of the recorded job."""
    word = f"REPLAY{record.name.removeprefix('replay')}, nothing moves"
    if request == "pause":
        return Headline(f"{word}, PAUSED", "p or c resumes; Escape or x ends it.", "replay")
    recorded = f"Recorded: {state.upper()}, {record.reason}. " if state != "running" and record.reason else ""
    return Headline(word, f"{recorded}p pauses and resumes; Escape or x ends it.", "replay")


def _of_run(workspace: Workspace) -> Headline:
    if workspace.profile is None:
        return Headline("NO CELL", NO_PROFILE, "idle")
    if workspace.folder is None:
        return Headline("NO RUN", NO_RUN, "idle")
    if workspace.in_use:
        return Headline("IN USE", f"by {workspace.in_use}. Shown is what was stored when it was opened.", "waiting")
    left, measured = stops_left(workspace), stops_measured(workspace)
    if not left:
        word = f"COMPLETE, {counted(measured, 'stop')}" if measured else "NO PLAN"
        text = "n goes to the next step." if measured else "This run has no stops to measure: plan a run (key 2)."
        return Headline(word, text, "done" if measured else "idle")
    if not measured:
        return Headline(f"READY, {counted(left, 'stop')}", "b begins. Nothing moves before it is confirmed.", "idle")
    word, text = (
        f"INTERRUPTED, {measured} of {counted(measured + left, 'stop')}",
        f"e measures the {counted(left, 'stop')} that are left.",
    )
    outcome = workspace.collection.sessions[-1].outcome if workspace.collection is not None else None
    if outcome == "accurate enough":
        word = f"ACCURATE ENOUGH, {measured} of {counted(measured + left, 'stop')}"
        text = f"n goes to the next step; e measures the {counted(left, 'stop')} that are left."
    elif outcome == "complete":
        word, text = f"{left} MORE STOPS", f"{measured} are measured; e measures those that were planned since."
    if drift_exceeded(workspace):
        text = f"The references moved beyond their limit: a accepts that and resumes. {text}"
    return Headline(word, text, "idle")
