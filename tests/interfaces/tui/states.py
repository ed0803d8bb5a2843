"""The states of a run and what the screens say in each: for the handbook's table and for the test that walks them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from contextlib import chdir
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from cellapp.commands.docs.keys import Step
from cellapp.commands.run_results import RunResults
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.ground.progress import JobState, Progress, StateChange
from cellapp.interfaces.tui.day_state import SIGNS, DayState, Mark, day_state
from cellapp.interfaces.tui.job_record import JobRecord
from cellapp.interfaces.tui.jobs import Job
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.screens.collect import headline
from cellapp.interfaces.tui.workspace import Workspace, load_workspace
from tests.cell.run.small_runs import collected_run, planned_run

RUN = Path("logs/day")
_NIGHT = datetime(2026, 1, 2, 2, 14)
_CONCLUDED: Mapping[Step, str] = {"calibrate": "was calibrated", "discover": "was searched for missing effects"}


@dataclass(frozen=True)
class Made:
    """How a state is made: the files of its run, and the job that works on it; ``watched``: of another process."""

    make: Callable[[], object]
    job: JobState | None = None
    watched: bool = False


def nothing() -> None:
    """No run."""


def part() -> None:
    """Two of four stops are measured, then a person stopped."""
    collected_run(RUN, "stopped")


def broken() -> None:
    """A run file that is none."""
    RUN.mkdir(parents=True)
    (RUN / "run.sqlite").write_bytes(b"no run")


def complete() -> None:
    """All stops are measured."""
    collected_run(RUN, "complete", 4)


STATES: Mapping[str, Made] = {
    "empty": Made(nothing),
    "planned": Made(lambda: planned_run(RUN).close()),
    "collecting": Made(part, "running"),
    "paused": Made(part, "paused"),
    "stopped": Made(part, "stopped"),
    "part": Made(part),
    "complete": Made(complete),
    "calibrated": Made(complete),
    "out of date": Made(complete),
    "broken": Made(broken),
    "read-only": Made(part),
    "watched": Made(part, "running", watched=True),
}
"""Two arms, four stops. What a calibration adds is put in by hand: it takes seconds, and changes only marks."""


def events(job: JobState) -> tuple[Progress, ...]:
    """What a collection has said when it is in a state: three of four stops are measured."""
    change = () if job == "running" else (Progress("collect", 3, 4, detail=StateChange(job, "link lost")),)
    return (Progress("collect", 3, 4, "stop 4", 60.0), *change)


def state_and_record(name: str) -> tuple[DayState, JobRecord]:
    """One of the states with what is known of its job, from files in the present folder."""
    made = STATES[name]
    made.make()
    without = _without_run()
    workspace = load_workspace(None, RUN) if RUN.exists() else without
    workspace = replace(workspace, profile=workspace.profile or without.profile)
    record, running = JobRecord(), None
    if made.job is not None:
        record.begin("collect")
        for event in events(made.job):
            record.add(event)
        record.since = _NIGHT
        process = 1 if made.watched else None
        running = Job("collect", lambda control, ask: None, RUN, moves=True, process=process)
    if name == "read-only":
        workspace = replace(workspace, read_only=True)
    state = day_state(workspace, record, running)
    return (
        _calibrated(state, outdated=name == "out of date") if name in ("calibrated", "out of date") else state
    ), record


def _without_run() -> Workspace:
    """A profile, and no run."""
    with planned_run(Path("another")) as run:
        return Workspace(profile=run.profile)


def _calibrated(state: DayState, *, outdated: bool) -> DayState:
    """The state once both were done; ``outdated``: and readings were added since."""
    kind = Mark("out of date", "out of date: 2 readings were added since") if outdated else None
    done = {step: kind or Mark("done", f"the run {words}") for step, words in _CONCLUDED.items()}
    marks = {**{step: replace(mark, is_next=False) for step, mark in state.marks.items()}, **done}
    after: Step = "calibrate" if outdated else "targets"
    marks[after] = replace(marks[after], kind=marks[after].kind if outdated else "next", is_next=True)
    calibrated = RunResults.model_construct(calibrate=CalibrateResult.model_construct())
    return replace(state, workspace=replace(state.workspace, results=calibrated), marks=marks)


def sentences(state: DayState, record: JobRecord) -> dict[str, str]:
    """Where -> what stands there in a state."""
    word, sentence, _ = headline(state, record, "none")
    steps = " ".join(f"{entry.key} {entry.title}{SIGNS[state.marks[entry.step].kind]}".strip() for entry in SCREENS)
    return {
        "first line": state.where,
        "steps": steps,
        "Collect": f"{word}: {sentence}",
        "Calibrate": state.nothing("calibrate", "") or "Held-out errors by stage.",
        "Accept": state.no_run or state.not_calibrated or "The verdict.",
    }


def states_table() -> list[list[str]]:
    """A row for each state with what the screens say, the headings first."""
    rows = []
    for name in STATES:
        with tempfile.TemporaryDirectory() as home, chdir(home):
            said = sentences(*state_and_record(name))
        rows.append([name, *said.values()])
        headings = ["state", *said]
    return [headings, *rows]
