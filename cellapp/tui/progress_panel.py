"""The panel that shows how far a run is: a bar for each step, the state, time left, the fit of the newest stop."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Label, ProgressBar

from cellapp.progress import JobState, Progress, StopReport, eta_words
from cellapp.reporting.progress_words import stop_words

JOBS = ("plan", "collect", "calibrate", "discover", "push")


class ProgressPanel(Vertical):
    """Draws events of a run; it decides nothing."""

    BORDER_TITLE = "progress"

    def compose(self) -> ComposeResult:
        for job in JOBS:
            with Horizontal(classes="job"):
                yield Label(job, classes="name")
                yield ProgressBar(total=1, show_percentage=False, show_eta=False, id=f"{job}-bar")
                yield Label("", id=f"{job}-count", classes="count", markup=False)
                yield Label("", id=f"{job}-note", classes="note", markup=False)
        yield Label("", id="eta", classes="live", markup=False)
        yield Label("", id="fit", classes="live", markup=False)

    def on_mount(self) -> None:
        """Start without reports."""
        self._fit: dict[str, str] = {}

    def begin(self) -> None:
        """Clear all bars for a new run."""
        self._fit.clear()
        for job in JOBS:
            self._draw(Progress(job, 0, 1), count="")
        for name in ("eta", "fit"):
            self.query_one(f"#{name}", Label).update("")

    def show(self, event: Progress) -> None:
        """Draw an event."""
        if event.job in JOBS:
            self._draw(event, count=f"{event.done}/{event.total}")
        self.query_one("#eta", Label).update(f"{event.job}: {eta_words(event.eta_s)}" if event.eta_s else "")
        if isinstance(event.detail, StopReport):
            self._fit[event.detail.arm] = stop_words(event.detail)
            self.query_one("#fit", Label).update("; ".join(self._fit.values()))

    def show_state(self, state: JobState | None) -> None:
        """Name the state in the title; None when no run is in progress."""
        self.border_title = self.BORDER_TITLE if state is None else f"{self.BORDER_TITLE}: {state}"
        self.set_classes("" if state is None else state)

    def _draw(self, event: Progress, count: str) -> None:
        self.query_one(f"#{event.job}-bar", ProgressBar).update(total=event.total, progress=event.done)
        self.query_one(f"#{event.job}-count", Label).update(count)
        if event.note or event.detail is None:
            self.query_one(f"#{event.job}-note", Label).update(event.note)
