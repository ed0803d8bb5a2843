"""Common base of all screens of the day: header with STOP in its corner, steps, message, footer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Vertical
from textual.events import Resize, ScreenResume
from textual.geometry import Size
from textual.screen import Screen
from textual.widgets import Static

from cellapp.commands.docs.keys import KEYS, SHOWN, Step
from cellapp.interfaces.tui.day_state import DayState
from cellapp.interfaces.tui.dialogs.question import BEGIN, USE_STALE, Choice, ChosenAnswer, Reading
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.job_record import JobRecord
from cellapp.interfaces.tui.keys import way_of, with_keys
from cellapp.interfaces.tui.verb_jobs import verb_job
from cellapp.interfaces.tui.widgets.arm_panel import LiveStrip
from cellapp.interfaces.tui.widgets.controls import KeyLine, Line
from cellapp.interfaces.tui.widgets.header import DayHeader, StepLine
from cellapp.interfaces.tui.widgets.progress_bars import ProgressBars
from cellapp.interfaces.tui.workspace import Workspace

if TYPE_CHECKING:
    from cellapp.commands.record import Request, Verb, View
    from cellapp.commands.run_results import RunResults
    from cellapp.estimation.calibration.records import CalibrateResult
    from cellapp.ground.results import Result, StageName
    from cellapp.interfaces.tui.host import Severity, ShowsResult
    from cellapp.interfaces.tui.jobs import Job

READING_WIDTH = 66
"""Characters per line of a text that fits into the narrowest terminal."""
_LEAST = (60, 16)
"""Columns and lines of the smallest terminal in which tables and plots are readable."""
_TOO_SMALL = "Make the terminal larger, at least 80x24. Jobs go on; STOP and all keys work."


class DayScreen(Screen[None]):
    """One step of the day. Subclasses compose ``body`` and draw in ``show_run`` and ``show_job``.

    Both are called when the screen is shown and whenever their data have changed; never while it is hidden.
    """

    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (100, "-medium"), (160, "-wide")]  # noqa: RUF012 - as Textual declares it
    STEP: ClassVar[Step]

    def __init__(self) -> None:
        super().__init__()
        self._state: DayState | None = None
        self._look: tuple[object, ...] = ()
        self._shown: Workspace | None = None

    def fit(self, size: Size) -> None:
        """Set the classes for a terminal of this size before the screen is mounted, so that its widgets find their
        styles only once, and not again at the first resize."""
        breaks = (size.width, self.HORIZONTAL_BREAKPOINTS), (size.height, self.VERTICAL_BREAKPOINTS)
        for length, breakpoints in breaks:
            reached = [name for least, name in breakpoints or () if length >= least]
            self.add_class(*reached[-1:], update=False)

    @property
    def cell_app(self) -> Host:
        """The application, with its workspace and its job."""
        return cast(Host, self.app)

    @property
    def workspace(self) -> Workspace:
        """The open profile and run."""
        return self.cell_app.workspace

    @property
    def _present_look(self) -> tuple[object, ...]:
        return self.app.theme, self.app.app_focus, self.app.classes

    @property
    def state(self) -> DayState:
        """The state of the run."""
        return self.cell_app.state

    def compose(self) -> ComposeResult:
        yield DayHeader()
        yield StepLine()
        yield LiveStrip()
        yield ProgressBars()
        yield Static(_TOO_SMALL, classes="too-small", markup=False)
        with Vertical(classes="body"):
            yield from self.body()
        yield Line(classes="next-words")
        yield Line(classes="message")
        yield KeyLine()

    def body(self) -> ComposeResult:
        """The widgets between header and message."""
        raise NotImplementedError

    def show_workspace(self, workspace: Workspace) -> None:
        """Draw the open profile and run, unless they are drawn already."""
        if workspace is not self._shown:
            self.show_run(workspace)
            self._shown = workspace  # only now: if a widget was missing above, the next call draws it

    def show_run(self, workspace: Workspace) -> None:
        """Draw the open profile and run, which have changed."""

    def draw_state(self) -> None:
        """Draw the parts of the state that all screens show, then this screen's parts, if they have changed."""
        state = self.state
        self.query_one(ProgressBars).show(self.cell_app.record)
        if state != self._state:
            self.query_one(DayHeader).show(state)
            self.query_one(StepLine).show(state.marks, self.STEP)
            line = self.query_one(".next-words", Line)
            line.display = state.job is None
            line.say(state.next_words)
            self.show_state(state)
            self._state = state  # only now: if a widget was missing above, the next call draws it

    def show_state(self, state: DayState) -> None:
        """Draw the sentences of this screen about the state."""

    def show_job(self, record: JobRecord) -> None:
        """Draw the current or the last job."""

    def show_result(self, result: Result, view: View) -> None:
        """Draw the result of a job that this screen started, or that ended while it is shown."""

    def read_result(self, result: Result, view: View) -> None:
        """Show the result of a job that no screen draws as a text to read."""
        from cellapp.interfaces.render.terminal import plain_text  # late: results are shown after the start
        from cellapp.interfaces.tui.widgets.parts_view import words_first

        text = with_keys(plain_text(words_first([*view.failed, *view.parts]), READING_WIDTH))
        self.app.push_screen(Reading(f"# {self.cell_app.record.name}\n\n```text\n{text}\n```"))

    def start(self, job: Job, shows_result: ShowsResult | None = None) -> None:
        """Start a job; if it cannot start, a sentence says why. By default this screen shows its result."""
        self.cell_app.start_job(job, shows_result=shows_result or self.show_result)

    def ask(self, question: Choice, begin: Callable[[], None]) -> None:
        """Ask, and begin unless the answer is no."""
        self.app.push_screen(question, lambda answer: begin() if answer not in (None, "no") else None)

    def moving_words(self, text: str) -> str:
        """Say with a text which arms move, and whether the model in force should not be used."""
        stale = self.workspace.stale
        return f"{text} {self.workspace.arms_words}." + (f"\nThe model is not up to date: {stale}." if stale else "")

    def ask_verb(
        self,
        verb: Verb,
        text: str,
        given: Mapping[str, Any],
        answers: Sequence[ChosenAnswer] = BEGIN,
        *,
        shows_result: ShowsResult | None = None,
        **more: Any,
    ) -> None:
        """Ask for the request of a verb, then run it; where arms move, say so, and ask whether a model out of date is
        used.

        ``more`` are further arguments of the dialog, as ``proposed`` values.
        """
        stale = self.workspace.stale if verb.moves_arms else ""
        if "out_of_date" in verb.request.model_fields:
            given, answers = {**given, "out_of_date": bool(stale)}, USE_STALE if stale else answers
        text = self.moving_words(text) if verb.moves_arms else text
        simulated = self.workspace.kind == "simulated"

        def begin(request: Request | None) -> None:
            if request is not None:
                self.start(verb_job(verb, request), shows_result)

        self.app.push_screen(VerbQuestion(verb, text, answers, given, simulated=simulated, **more), begin)

    def begin_next(self, command: str) -> bool:
        """Begin the next command, as its key on this screen does; return False if none does it now."""
        step, meaning = way_of(command) or ("", "")
        for binding in type(self).BINDINGS if step == self.STEP else ():
            if isinstance(binding, Binding) and binding.key == KEYS[meaning].keys:
                possible = bool(self.check_action(binding.action, ()))
                if possible:
                    self.call_next(self.run_action, binding.action)
                return possible
        return False

    def outdated(self, stage: StageName, key: str, does: str) -> list[str]:
        """Return the mark of a stage's result that is out of date, with the key that ``does`` it; empty if it holds."""
        results = self.workspace.results
        reason = None if results is None else results.out_of_date.get(stage)
        return [] if reason is None else [f"! out of date: {reason}; {SHOWN[key]} {does}"]

    def show_runs(self) -> None:
        """List all runs; only the screen Cell does."""

    def open_folder(self) -> Path | None:
        """Return the folder of the open run; if there is none, say what to do and return None."""
        if no_run := self.state.no_run:
            self.say(no_run, "warning")
            return None
        return self.workspace.folder

    def calibrated_run(self) -> tuple[Path, RunResults, CalibrateResult] | None:
        """Return the open run with its content if it is calibrated; else say what to do and return None."""
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
        """Draw a sentence instead of the body if the terminal is too small; a subclass's handler runs as well."""
        self.set_class(event.size.width < _LEAST[0] or event.size.height < _LEAST[1], "-too-small")

    def on_mount(self) -> None:
        """Store the state on which the styles of the new widgets depend."""
        self._look = self._present_look

    def on_screen_resume(self, event: ScreenResume) -> None:
        """Draw what changed while another screen was shown; refresh styles only if they may have changed."""
        look = self._present_look
        event.refresh_styles = look != self._look  # it matches all widgets against all rules: half the time of a switch
        self._look = look
        self.call_after_refresh(self.cell_app.draw_all)
