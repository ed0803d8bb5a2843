"""The headline of the screen Collect: the state, and what can be done now. Draws nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cellapp.ground.control import Request
from cellapp.ground.counting import counted
from cellapp.ground.progress import JobState
from cellapp.interfaces.tui.job_record import JobRecord
from cellapp.interfaces.tui.keys import SHOWN
from cellapp.interfaces.tui.run_state import COPY_IT, RunState, holds_for_drift
from cellapp.interfaces.tui.terminal_signals import since_words

Look = Literal["idle", "running", "waiting", "halted", "done"]

_STOP, _PAUSE = SHOWN["stop"], SHOWN["pause"]
_RESUMES, _ENDS = f"{_PAUSE} or {SHOWN['resume']} resumes", f"{SHOWN['abort']} ends it."
_DOING: dict[JobState, tuple[Look, str]] = {
    "running": ("running", f"{_STOP} brakes all arms; {_PAUSE} pauses after this stop; {_ENDS}"),
    "pausing": ("waiting", f"The arms rest after this stop. {_RESUMES}; {_STOP} brakes."),
    "paused": ("waiting", f"The arms rest. {_RESUMES}; {_STOP} stops; {_ENDS}"),
    "suspended": ("waiting", f"It resumes by itself once the cause is gone. {_STOP} stops; {_ENDS}"),
    "stopped": ("halted", f"{SHOWN['resume']} resumes when the cell is clear; {_ENDS}"),
    "aborted": ("halted", "The arms brake and the job ends; what was measured is kept."),
}


@dataclass(frozen=True)
class Headline:
    """A word, a sentence with what can be done, and their style."""

    word: str
    sentence: str
    look: Look


def headline(run: RunState, record: JobRecord, request: Request) -> Headline:
    """Return the state of the job, else of the run; ``request`` is the last request of a person to the job."""
    if record.state is None:
        return _of_run(run)
    if run.job is not None and not run.job.moves:
        return Headline("RUNNING", f"{record.name}: nothing moves. {_STOP} or {_ENDS}", "running")
    state = record.state
    if state in ("running", "pausing") and record.causes:  # the job's thread has not noticed yet, or hangs
        return Headline("STOPPED", f"{'; '.join(record.causes).rstrip('.')}. {_DOING['stopped'][1]}", "halted")
    if record.lost and state != "stopped":  # a stopped job gives the reason and what to do; the strip shows the ages
        text = f"from {', '.join(record.lost)}: what is shown of it is old. {_STOP} brakes all arms."
        return Headline("NO DATA", text, "halted")
    if state == "running" and request != "none":
        state = {"pause": "pausing", "stop": "stopped", "abort": "aborted"}[request]  # type: ignore[assignment]
    look, possible = _DOING[state]
    if holds_for_drift(record):
        possible = f"Look for a moved tracker, nest or SMR. {SHOWN['drift']} accepts the drift and resumes, as"
        possible += f" {SHOWN['resume']} does; {_ENDS}"
    waits = record.reason and state == record.state != "running"
    return Headline(state.upper(), f"{since_words(record)}. {possible}" if waits else possible, look)


def _of_run(state: RunState) -> Headline:
    if state.no_run:
        return Headline("NO CELL" if state.stored == "no cell" else "NO RUN", state.no_run, "idle")
    if state.reading:
        return Headline("READING", state.reading, "idle")
    if state.in_use:
        return Headline("IN USE", f"by {state.in_use}. Shown is what was stored when it was opened.", "waiting")
    word, sentence, look = _of_stops(state)
    if state.read_only:
        sentence = COPY_IT
    elif state.drift and state.left:
        sentence = f"The references moved beyond their limit: {SHOWN['drift']} accepts that and resumes. {sentence}"
    return Headline(word, sentence, look)


def _of_stops(state: RunState) -> tuple[str, str, Look]:
    go, on, left, measured = SHOWN["go"], f"{SHOWN['next']} goes to the next step", state.left, state.measured
    if not left and not measured:
        return "NO PLAN", f"This run has no stops to measure: keys 2, {go} plan a run.", "idle"
    if not left:
        return f"COMPLETE, {counted(measured, 'stop')}", f"{on}.", "done"
    if not measured:
        return f"READY, {counted(left, 'stop')}", f"{go} begins. Nothing moves before it is confirmed.", "idle"
    if state.outcome == "accurate enough":
        sentence = f"{on}; {go} measures the {counted(left, 'stop')} that are left."
        return f"ACCURATE ENOUGH, {measured} of {counted(measured + left, 'stop')}", sentence, "idle"
    if state.outcome == "complete":
        return f"{left} MORE STOPS", f"{measured} are measured; {go} measures those that were planned since.", "idle"
    sentence = f"{go} measures the {counted(left, 'stop')} that are left."
    return f"INTERRUPTED, {measured} of {counted(measured + left, 'stop')}", sentence, "idle"
