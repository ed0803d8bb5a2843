"""The only state of the run, derived once from the run file and the job's reports; draws nothing.

All sentences of the screens about the state are made here: which run, what is planned, measured and calibrated, what
runs now, what each step concluded, why a screen has nothing to show.

Marks of the steps, as a sign and in words: what each step concluded, as completion alone is not a verdict.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cellapp.commands.docs.keys import SHOWN, STEPS, Step
from cellapp.ground.progress import JobState
from cellapp.interfaces.tui.job_record import JobRecord, within_limit
from cellapp.interfaces.tui.jobs import Job
from cellapp.interfaces.tui.keys import step_of, with_keys
from cellapp.interfaces.tui.workspace import Workspace

if TYPE_CHECKING:
    from cellapp.commands.next_step import Conclusion


Kind = Literal["open", "next", "running", "done", "conforms", "not decided", "part", "does not conform", "out of date"]
SIGNS: Mapping[Kind, str] = {
    "open": " ",
    "next": "▸",
    "running": "…",
    "done": "✓",
    "conforms": "≤",
    "not decided": "?",
    "part": "◐",
    "does not conform": "✗",
    "out of date": "!",
}
"""Sign of each kind: ``done`` is done and up to date, ``conforms`` is within its tolerance given its uncertainty."""


@dataclass(frozen=True)
class Mark:
    """Progress of a step, also in words; ``is_next`` if it is the next step, whatever its mark."""

    kind: Kind
    words: str
    is_next: bool = False


def next_step(workspace: Workspace) -> Step:
    """Return the step that comes next; if nothing is left, that of another run."""
    if workspace.profile is None:
        return "cell"
    if workspace.overview is None:
        return "plan"
    return step_of(workspace.overview.next_verb) or "cell"


def _next_words(workspace: Workspace, waits: str) -> str:
    """Return what comes next and the key that goes there."""
    key, words = SHOWN["next"], "" if workspace.overview is None else workspace.overview.next_step
    last = f"; {SHOWN['last']} goes on with the last run, {waits}" if waits and workspace.folder is None else ""
    if workspace.profile is None:
        return f"Next: choose a profile{last}"
    if workspace.overview is None:
        return f"Next ({key}): plan a run{last}"
    if workspace.read_only:
        return "Next: copy the run to go on with it; this folder cannot be written"
    if not words:
        return f"Next: nothing is left to do in this run; {SHOWN['runs']} lists all"
    if words.startswith("cellapp "):  # its folder may be quoted
        words = ", ".join(filter(None, [workspace.overview.next_verb, "'" + words.replace("'", "") + "'"]))
    return f"Next ({key}): {with_keys(words)}"


def marks_of(workspace: Workspace, measured: int, planned: int, todo: int, running: Step | None) -> dict[Step, Mark]:
    """Return the mark of every step; ``running`` is the step that a job does now."""
    marks: dict[Step, Mark] = {step: Mark("open", "not begun") for step in STEPS}
    if workspace.profile is not None:
        marks["cell"] = Mark("done", "a profile is open")
    if workspace.overview is not None:
        marks["plan"] = (
            Mark("done", f"{planned} stops are planned") if planned else Mark("done", "readings are imported")
        )
    if measured:
        marks["collect"] = _collected(workspace, measured, planned, todo)
    marks.update(_concluded(workspace))
    after = next_step(workspace)
    for step, mark in marks.items():
        if step == running:
            marks[step] = Mark("running", "a job does it now")
        elif step == after:
            marks[step] = Mark("next" if mark.kind == "open" else mark.kind, mark.words, is_next=True)
    return marks


def _collected(workspace: Workspace, measured: int, planned: int, todo: int) -> Mark:
    collection = workspace.collection
    if collection is not None and collection.missing_share > collection.tolerated_share:
        return Mark("part", f"{collection.missing_share:.0%} of the planned readings are missing")
    accurate = workspace.outcome == "accurate enough"
    if todo and not accurate:
        return Mark("part", f"{measured} of {planned} stops are measured")
    return Mark("done", f"{measured} stops are measured" + (", accurate enough" if todo else ""))


def _concluded(workspace: Workspace) -> dict[Step, Mark]:
    """Return the marks of steps with stored results: the worst valid conclusion, or that something is out of date."""
    found: dict[Step, list[Conclusion]] = {}
    for stage, conclusion in workspace.conclusions.items():
        if (step := step_of(stage)) is not None:  # a later version may have other stages
            found.setdefault(step, []).append(conclusion)
    if not found and not workspace.overview:
        return {}
    from cellapp.commands.next_step import Conclusion, worst  # late: only needed once a run was read

    accept = found.setdefault("accept", [])
    if workspace.overview is not None and workspace.overview.complaints:  # that screen lists them all
        accept.append(Conclusion("out of date", "; ".join(workspace.overview.complaints)))
    if workspace.conformity is not None and (accept or workspace.reported):
        accept.append(Conclusion(workspace.conformity, f"the run: {workspace.conformity}"))
    elif workspace.reported:
        accept.append(Conclusion("done", "the report is written; the profile has no tolerances"))
    return {step: Mark(one.kind, one.words) for step, several in found.items() if (one := worst(several)) is not None}


@dataclass(frozen=True)
class JobNow:
    """The current job: its name, state and folder, and the number of stops that it has measured.

    ``step`` is its step; None if it belongs to none. ``moves``: whether arms may move.
    """

    name: str
    state: JobState
    folder: Path | None
    step: Step | None
    watched: bool = False
    stops: int | None = None
    moves: bool = True

    @property
    def words(self) -> str:
        """What it does, as "collecting is PAUSED"."""
        return f"'{self.name}' {'runs' if self.state == 'running' else f'is {self.state.upper()}'}"


@dataclass(frozen=True)
class DayState:
    """State of the open run and the current job.

    Attributes
    ----------
    workspace : Workspace
        The profile and the run as they were read.
    planned, measured : int
        Stops without reserves; measured ones as reported by the job, which is ahead of the file as it was read.
    remaining : int
        Planned stops that are not measured.
    job : JobNow or None
    next_words : str
        What comes next and its key, as "Next (n): collect, keys 3, b".
    reading : str
        Sentence that the first profile, or the result of a job, is being read; empty if it is already shown.
    marks : mapping
        Step -> its mark.
    """

    marks: Mapping[Step, Mark]
    workspace: Workspace
    planned: int
    measured: int
    remaining: int
    job: JobNow | None
    next_words: str
    reading: str

    @property
    def where(self) -> str:
        """Profile and run, for the first line."""
        cell, job = self.workspace, self.job
        profile = "no profile" if cell.profile is None else cell.profile.name
        run = cell.folder or (None if job is None else job.folder) or "no run is open"
        return f"{profile} · {run}" + (" · READ-ONLY" if cell.read_only else "")

    @property
    def measured_words(self) -> str:
        """How many stops are measured: "215 of 400 stops are measured"."""
        if not self.planned:
            return f"{self.measured} stops are measured" if self.measured else "no stop is planned"
        return f"{self.measured} of {self.planned} stops are measured"

    @property
    def no_run(self) -> str:
        """Why there is no run to work on, and what to do; empty if a readable one is open."""
        if self.workspace.folder is not None and self.workspace.profile is not None:
            return ""
        if self.job is not None and self.job.folder is not None:
            return f"{self.job.folder} is being made: {self.job.words}."
        if self.reading:
            return self.reading
        if self.workspace.problem:
            return self.workspace.problem
        if self.workspace.profile is None:
            return "No profile is open: choose one on the screen Cell (key 1)."
        return f"No run is open: plan one (keys 2, {SHOWN['go']}), or open one of all runs (key {SHOWN['runs']})."

    @property
    def no_profile(self) -> str:
        """Why nothing new can be planned: no profile file was read."""
        return self.no_run or "No profile's file is open beside this run: choose one on the screen Cell (key 1)."

    @property
    def not_calibrated(self) -> str:
        """Why there is no calibration; empty if there is one."""
        if self.no_run or self.workspace.stored("calibrate") is not None:
            return self.no_run
        return self.reading or f"Not calibrated yet: {self.measured_words}."

    @property
    def not_collected(self) -> str:
        """What the file contains of the collecting, if it has no tables or no residuals to show."""
        return self.no_run or self.reading or f"Nothing is stored of collecting; {self.measured_words}."

    def nothing(self, step: Step, else_: str) -> str:
        """Return why a step has nothing to show; ``else_`` if only the step itself was not done."""
        if (job := self.job) is not None and job.step == step and not self.no_run:
            return f"Nothing is stored yet: {job.words}."
        return self.not_calibrated or else_


def day_state(
    workspace: Workspace, record: JobRecord, running: Job | None = None, waits: str = "", reading: str = ""
) -> DayState:
    """Return the state of the open run and the running job.

    ``waits`` is the run that was open last, in words; ``reading`` says what is not read yet.
    """
    job = _job_now(record, running)
    here = job is not None and (job.folder is None or job.folder == workspace.folder)
    stops = () if workspace.stops is None or workspace.profile is None else workspace.stops.stops
    reserves = frozenset() if workspace.profile is None else frozenset(workspace.profile.plan.reserves(len(stops)))
    measured = sum(stop.measured for stop in stops)
    if not stops and workspace.overview is not None:
        measured = max((arm.measured for arm in workspace.overview.arms.values()), default=0)
    todo = sum(not stop.measured and stop.configuration not in reserves for stop in stops)
    if here and job is not None and job.stops is not None:
        todo = max(todo - max(job.stops - measured, 0), 0)
        measured = max(measured, job.stops)
    planned = len(stops) - len(reserves)
    return DayState(
        marks=marks_of(workspace, measured, planned, todo, job.step if here and job is not None else None),
        workspace=workspace,
        planned=planned,
        measured=measured,
        remaining=todo,
        job=job,
        next_words=_next_words(workspace, waits),
        reading="" if running is not None else reading,
    )


def holds_for_drift(record: JobRecord) -> bool:
    """Return whether the job was stopped by references beyond their limit."""
    newest = record.references[-1] if record.references else None
    by_reference = record.reason.startswith("reference ")
    return record.state == "stopped" and by_reference and (newest is None or not within_limit(newest))


def _job_now(record: JobRecord, running: Job | None) -> JobNow | None:
    if record.state is None:
        return None
    verb, watched = record.name.split(" ")[0], running is not None and running.process is not None
    collected = record.progress.get("collect")
    part = record.latest.job if record.name == "run" and record.latest is not None else verb
    return JobNow(
        record.name,
        record.state,
        None if running is None else running.folder,
        step_of(part),
        watched,
        None if collected is None else collected.done,
        running is None or running.moves or watched,
    )
