"""The two top lines of every screen: the cell, the run, STOP; the steps of the day."""

from __future__ import annotations

from collections.abc import Mapping

from rich.cells import cell_len
from textual.app import ComposeResult
from textual.containers import Horizontal

from cellapp.commands.docs.keys import Step
from cellapp.interfaces.tui.day_state import SIGNS, DayState, Mark
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.widgets.controls import Line, StopButton

_BADGES: Mapping[str, str] = {"none": "NO ARMS", "real": "REAL ARMS"}
"""Badge of a kind of cell, if it is not the kind itself."""


class DayHeader(Horizontal):
    """Badge, profile, run, job, STOP."""

    def compose(self) -> ComposeResult:
        yield Line(classes="badge")  # unknown yet whose arms they are
        yield Line(classes="where")
        yield Line(classes="job")
        yield StopButton()

    def show(self, state: DayState) -> None:
        """Draw the open run and the running job."""
        job, kind, words = state.job, state.workspace.kind, ""
        badge = f" {_BADGES.get(kind, kind.upper())} "
        if job is not None and job.watched:
            badge = f" WATCHED ·{badge}"
        if job is not None:  # the bars say how far it is
            words = job.name if job.state == "running" else f"{job.name} {job.state.upper()}"
        self.query_one(".badge", Line).say(badge, f"badge {kind}")
        self.query_one(".where", Line).say(state.where)
        line = self.query_one(".job", Line)
        line.say(words, f"job {'idle' if job is None else job.state}")
        line.styles.width = cell_len(words) + 2  # set explicitly: its container does not always ask again
        self.set_class(job is not None, "running")
        self.set_class(kind == "real", "real")


class StepLine(Horizontal):
    """The steps of the day with their keys and states; the current screen is marked, a click shows another."""

    def compose(self) -> ComposeResult:
        for entry in SCREENS:
            yield StepTab(entry.step)

    def show(self, marks: Mapping[Step, Mark], present: Step) -> None:
        """Draw the marks; use short titles if the line is narrow."""
        for tab in self.query(StepTab):
            tab.show(marks[tab.step], present=tab.step == present)


class StepTab(Line):
    """One step; a click shows its screen."""

    def __init__(self, step: Step) -> None:
        super().__init__(classes="step")
        self.step: Step = step
        self._entry = next(entry for entry in SCREENS if entry.step == step)

    def show(self, mark: Mark, *, present: bool) -> None:
        """Draw key, title and mark."""
        classes = ["step", mark.kind.replace(" ", "-"), *(["next"] if mark.is_next else [])]
        text = f"{self._entry.key} {self._entry.title}{SIGNS[mark.kind]}"
        self.say(text, " ".join([*classes, *(["present"] if present else [])]))
        self.tooltip = f"{self._entry.title}: {self._entry.purpose}; {mark.words}. Key {self._entry.key}."

    async def on_click(self) -> None:
        """Show the screen."""
        await self.run_action(f"app.show('{self.step}')")
