"""The two lines on top of every screen: which cell, which run, STOP; the steps of the day."""

from __future__ import annotations

from collections.abc import Mapping

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.content import Content
from textual.message import Message
from textual.widgets import Static

from cellapp.ground.progress import eta_words
from cellapp.interfaces.tui.job_record import JobRecord
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.widgets.stop import StopButton
from cellapp.interfaces.tui.workspace import Step, StepState, Workspace

_BADGES: Mapping[str, str] = {
    "none": " NO ARMS ",
    "simulated": " SIMULATED ",
    "emulated": " EMULATED ",
    "real": " REAL ARMS ",
    "replay": " REPLAY ",
}
_MARKS: Mapping[StepState, str] = {"open": " ", "next": "▸", "done": "✓", "out of date": "!"}


class DayHeader(Horizontal):
    """Badge, profile, run, job, STOP."""

    def __init__(self) -> None:
        super().__init__()
        self._drawn: tuple[object, ...] = ()

    def compose(self) -> ComposeResult:
        yield Static(_BADGES["none"], classes="badge", markup=False)
        yield Static("", classes="where", markup=False)
        yield Static("", classes="job", markup=False)
        yield StopButton()

    def show(self, workspace: Workspace, record: JobRecord) -> None:
        """Draw what is open and what runs."""
        where = f"{profile_name(workspace)} · {'no run' if workspace.folder is None else workspace.folder}"
        replays = record.is_replay and record.state is not None
        kind = "replay" if replays else workspace.kind
        attached = record.attached and record.state is not None
        drawn = (kind, attached, where, job_words(record), record.state)
        if drawn == self._drawn:
            return
        self._drawn = drawn
        badge = self.query_one(".badge", Static)
        badge.update(f" ATTACHED ·{_BADGES[kind]}" if attached else _BADGES[kind])
        badge.set_classes(f"badge {kind}")
        self.query_one(".where", Static).update(where)
        job = self.query_one(".job", Static)
        job.update(job_words(record))
        job.set_classes(f"job {record.state or 'idle'}")
        self.set_class(record.state is not None, "running")
        self.set_class(kind == "real", "real")


class StepLine(Horizontal):
    """The steps of the day with their keys and states; the present screen is marked, a click shows another."""

    def compose(self) -> ComposeResult:
        for entry in SCREENS:
            yield StepTab(entry.step)

    def show(self, workspace: Workspace, present: Step) -> None:
        """Draw the states; short titles where the line is narrow."""
        states = workspace.states()
        for tab in self.query(StepTab):
            tab.show(states[tab.step], present=tab.step == present)


class StepTab(Static):
    """One step: a click shows its screen."""

    class Chosen(Message):
        """The screen of a step is asked for."""

        def __init__(self, step: Step) -> None:
            super().__init__()
            self.step = step

    def __init__(self, step: Step) -> None:
        super().__init__("", classes="step", markup=False)
        self.step: Step = step
        self._drawn: tuple[StepState, bool] | None = None
        self._entry = next(entry for entry in SCREENS if entry.step == step)

    def show(self, state: StepState, *, present: bool) -> None:
        """Draw key, title and state."""
        drawn = (state, present)
        if drawn == self._drawn:
            return
        self._drawn = drawn
        self.update(Content(f"{self._entry.key} {self._entry.title}{_MARKS[state]}"))
        self.set_classes(f"step {state.replace(' ', '-')}{' present' if present else ''}")
        self.tooltip = f"{self._entry.title}: {self._entry.purpose}; {state}. Key {self._entry.key}."

    def on_click(self) -> None:
        """Show the screen."""
        self.post_message(self.Chosen(self.step))


def profile_name(workspace: Workspace) -> str:
    """Name of the open profile."""
    return "no profile" if workspace.profile is None else workspace.profile.name


def job_words(record: JobRecord) -> str:
    """The present job in a few words: "collect 12/400, 3 min left"; empty without a job."""
    latest = record.latest
    if record.state is None:
        return ""
    if latest is None:
        return f"{record.name} ..."
    state = "" if record.state == "running" else f" {record.state.upper()}"
    eta = eta_words(latest.eta_s) if latest.eta_s else ""
    return f"{latest.job}{state} {latest.done}/{latest.total}" + (f", {eta}" if eta else "")
