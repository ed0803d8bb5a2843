"""What all screens of the day share: the header with STOP in its corner, the steps, the message, the footer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, cast

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Vertical
from textual.events import Resize, ScreenResume
from textual.geometry import Size
from textual.screen import Screen
from textual.widgets import Static

from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.job_record import JobRecord
from cellapp.interfaces.tui.keys import KEYS, WAYS
from cellapp.interfaces.tui.run_state import RunState
from cellapp.interfaces.tui.widgets.header import DayHeader, StepLine
from cellapp.interfaces.tui.widgets.job_panel import JobPanel
from cellapp.interfaces.tui.widgets.key_line import KeyLine
from cellapp.interfaces.tui.widgets.live_strip import LiveStrip
from cellapp.interfaces.tui.workspace import Step, Workspace

if TYPE_CHECKING:
    from cellapp.commands.report.result import RunResults
    from cellapp.estimation.calibration.records import CalibrateResult
    from cellapp.ground.results import Result
    from cellapp.interfaces.tui.jobs import Job
    from cellapp.interfaces.tui.messages import Severity

_LEAST = (60, 16)
"""Columns and lines of a terminal below which tables and plots cannot be read."""
_TOO_SMALL = "Make the terminal larger, at least 80x24. Jobs go on; STOP and all keys work."


READING_RUNS = "reading the folder of runs ..."
"""What stands where something of the runs will stand."""


class DayScreen(Screen[None]):
    """One step of the day. Subclasses compose ``body`` and draw in ``show_workspace`` and ``show_job``.

    Both are called when the screen is shown and whenever what they draw has changed meanwhile; never while the screen
    is hidden.
    """

    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (100, "-medium"), (160, "-wide")]  # noqa: RUF012 - as Textual declares it
    STEP: ClassVar[Step]
    SHOWS_JOB: ClassVar[bool] = True
    """Whether the panel of the live job stands above its body; a screen that shows the job whole has none."""
    HELP: ClassVar[str] = ""
    """Markdown for the key ``?``: what the screen shows and what one does here."""

    def __init__(self) -> None:
        super().__init__()
        self._state: RunState | None = None
        self._look: tuple[object, ...] = ()

    def fit(self, size: Size) -> None:
        """Before the screen is made, take the classes of a terminal of this size: its widgets then find their styles
        once, and not again at the first resize."""
        breaks = (size.width, self.HORIZONTAL_BREAKPOINTS), (size.height, self.VERTICAL_BREAKPOINTS)
        for length, breakpoints in breaks:
            reached = [name for least, name in breakpoints or () if length >= least]
            self.add_class(*reached[-1:], update=False)

    @property
    def cell_app(self) -> Host:
        """The application with its workspace and its job."""
        return cast(Host, self.app)

    @property
    def workspace(self) -> Workspace:
        """What is open."""
        return self.cell_app.workspace

    @property
    def _present_look(self) -> tuple[object, ...]:
        return self.app.theme, self.app.app_focus, self.app.classes

    @property
    def state(self) -> RunState:
        """The one state of the run."""
        return self.cell_app.state

    def compose(self) -> ComposeResult:
        yield DayHeader()
        yield StepLine()
        yield LiveStrip()
        if self.SHOWS_JOB:
            yield JobPanel()
        yield Static(_TOO_SMALL, classes="too-small", markup=False)
        with Vertical(classes="body"):
            yield from self.body()
        yield Static("", classes="message", markup=False)
        yield KeyLine()

    def body(self) -> ComposeResult:
        """The widgets between header and message."""
        raise NotImplementedError

    def show_workspace(self, workspace: Workspace) -> None:
        """Draw the profile and the run that are open."""

    def draw_state(self) -> None:
        """Draw what every screen says about the state, then what this one does, where it has changed."""
        state = self.state
        record = self.cell_app.record
        self.query_one(DayHeader).show(state, self.workspace.kind, record)
        for panel in self.query(JobPanel):
            panel.show(record)
        if state != self._state:
            self.query_one(StepLine).show(state.marks, self.STEP)
            self.show_state(state)
            self._state = state  # drawn: where a widget was not there yet, the next time draws it

    @property
    def unsaved(self) -> str:
        """What would be lost with this screen, in words; empty if nothing."""
        return ""

    def show_state(self, state: RunState) -> None:
        """Draw the sentences of this screen about the state."""

    def show_job(self, record: JobRecord) -> None:
        """Draw the present or the last job."""

    def show_result(self, result: Result) -> None:
        """Draw the result of a job that this screen asked for, or that ended while it is shown."""

    def start(self, job: Job) -> None:
        """Start a job; a sentence says why where that is not possible."""
        if self.cell_app.start_job(job):
            self.cell_app.asked_by = self

    def begin_next(self, verb: str) -> None:
        """Begin what comes next, a verb of this step; empty: the step's own work."""
        _, meaning = WAYS.get(verb, (self.STEP, "go"))
        for binding in type(self).BINDINGS:
            if isinstance(binding, Binding) and binding.key == KEYS[meaning].keys:
                self.call_next(self.run_action, binding.action)
                return

    def leave_field(self) -> None:
        """Leave a field in which a text is typed: what is pressed next is a key."""
        self.set_focus(None)

    def open_folder(self) -> Path | None:
        """Folder of the run that is open; without one, a sentence says what to do."""
        if no_run := self.state.no_run:
            self.say(no_run, "warning")
            return None
        return self.workspace.folder

    def calibrated_run(self) -> tuple[Path, RunResults, CalibrateResult] | None:
        """The run that is open with what it holds, if it is calibrated; else a sentence says what to do."""
        folder, results = self.open_folder(), self.workspace.results
        if folder is None:
            return None
        if results is None or results.calibrate is None:
            self.say(self.state.not_calibrated, "warning")
            return None
        return folder, results, results.calibrate

    def say(self, text: str, severity: Severity = "information") -> None:
        """Show a sentence in the message line of every screen."""
        self.cell_app.say(text, severity)

    def on_resize(self, event: Resize) -> None:
        """Draw a sentence instead of the body where the terminal is too small; a subclass's method runs, too."""
        self.set_class(event.size.width < _LEAST[0] or event.size.height < _LEAST[1], "-too-small")

    def on_mount(self) -> None:
        """Note by what its widgets find their styles as they are made."""
        self._look = self._present_look

    def on_screen_resume(self, event: ScreenResume) -> None:
        """Draw what changed while another screen was shown; find styles anew only where they can have changed."""
        look = self._present_look
        event.refresh_styles = look != self._look  # all widgets against all rules: half of a switch
        self._look = look
        self.call_after_refresh(self.cell_app.draw_all)
