"""The screen of one run: choose a profile, start, watch, stop, read the tables. All work is done by ``run_whole``."""

from __future__ import annotations

import contextlib
import shlex
import threading
import traceback
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Literal, TypeVar

from rich.text import Text
from textual import on
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, ItemGrid, Vertical, VerticalScroll
from textual.events import DescendantFocus
from textual.message import Message
from textual.screen import ModalScreen
from textual.widget import Widget
from textual.widgets import (
    Button,
    DataTable,
    Footer,
    Input,
    Label,
    OptionList,
    ProgressBar,
    RichLog,
    Static,
    TabbedContent,
    TabPane,
)

from cellapp.control import JobControl
from cellapp.errors import CellappError, HardwareError
from cellapp.pipeline import default_folder, run_whole
from cellapp.progress import Cancelled, Listener, Progress
from cellapp.reporting.page import PAGE_FILE
from cellapp.reporting.table import Table
from cellapp.reporting.tables import all_tables, out_of_date_sentences
from cellapp.results import DISCOVER, WholeRunResult

W = TypeVar("W", bound=Widget)
Run = Callable[[Path, Path | None, Listener, JobControl | None], WholeRunResult]

JOBS = ("plan", "collect", "calibrate", "discover", "push")
ERROR_LOG = "error.log"
STOPPED = 4
UNEXPECTED = 3
"""Exit codes: stopped and resumable; an unexpected error, after which somebody must look at the cell."""

_RESUME_COMMANDS = {
    "collect": "cellapp collect {} --resume",
    "calibrate": "cellapp calibrate {}",
    "discover": "cellapp discover {}",
    "push": "cellapp push {} TARGETS --verify",
}
_TABLE_WIDTH = 66
"""Narrowest column of tables [characters]: an accuracy table fits, and a wide screen shows two side by side."""
_NO_TABLES = "Tables appear here when a run has ended."
_HELP = {
    "profiles": "Profiles: up and down select one, Enter goes to Run.",
    "profile": "Profile to run: select one above, or type the path of another.",
    "folder": "Folder of the run: new or empty. If left blank: a new folder in logs.",
    "run": "Start: plan, collect, calibrate, discover, push. THE ARMS WILL MOVE. (F5, r)",
    "stop": "Stop at the next step; measured data are kept. (Escape, s)",
    "progress": "Progress of each step: done of total, and the current action.",
    "status": "Current action, or how the run ended.",
    "results": "Left, right, or l and t: log or tables. f: full screen.",
    "log": "Events, newest last: up, down, Page Up and Page Down scroll.",
    "tables": "Errors at held-out stops and at targets: up, down, Page Up, Page Down scroll.",
    "stay": "Continue the run. (n, Escape)",
    "leave": "Stop the run at its next step, wait for its end, then quit. (y)",
}


class RunProgressed(Message):
    """The run reported progress."""

    def __init__(self, event: Progress) -> None:
        super().__init__()
        self.event = event


class RunEnded(Message):
    """The thread of the run ended, with a result or an exception."""

    def __init__(self, ending: WholeRunResult | BaseException) -> None:
        super().__init__()
        self.ending = ending


class LeaveScreen(ModalScreen[bool]):
    """Ask whether to stop a run in order to quit."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "dismiss(True)", "Stop and quit"),
        Binding("n,escape", "dismiss(False)", "Continue"),
        Binding("left,right", "app.focus_next", show=False),
    ]

    def compose(self) -> ComposeResult:
        with Vertical(id="question"):
            yield Static("A run is in progress. Stop it at its next step and quit?", markup=False)
            with Horizontal(id="answers"):
                yield _helped(Button("Continue (n)", id="stay", compact=True))
                yield _helped(Button("Stop and quit (y)", id="leave", variant="error", compact=True))

    @on(Button.Pressed)
    def answer(self, event: Button.Pressed) -> None:
        """Close the question with the answer."""
        event.stop()
        self.dismiss(event.button.id == "leave")


class CellApp(App[None]):
    """The application with its one screen.

    Parameters
    ----------
    profiles : Path
        Folder whose ``*.yaml`` are listed.
    run : callable
        Runs everything, in a thread of its own; same signature as ``run_whole``.
    patience_s : float
        How long quitting waits for a run to stop before the program ends without it.
    """

    TITLE = "cellapp"
    CSS_PATH = "app.tcss"
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f5,r", "run", "Run"),
        Binding("escape,s", "stop", "Stop"),
        Binding("l", "show('log-pane')", "Log"),
        Binding("t", "show('tables-pane')", "Tables"),
        Binding("f", "toggle_full", "Full"),
        Binding("q", "quit", "Quit"),
        Binding("ctrl+q", "quit", show=False, priority=True),
    ]

    def __init__(self, profiles: Path, run: Run = run_whole, patience_s: float = 60.0) -> None:
        super().__init__()
        self._found = sorted(profiles.glob("*.yaml"), key=lambda path: path.stem)
        self._profiles = profiles
        self._run = run
        self._patience_s = patience_s
        self._cancel = JobControl()
        self._worker: threading.Thread | None = None
        self._folder = Path()
        self._last: Progress | None = None
        self._leaving = False
        self._code = 0

    @property
    def running(self) -> bool:
        """Whether a run was started and has not reported its end yet."""
        return self._worker is not None

    # -- the screen ------------------------------------------------------------------------------------------------

    def compose(self) -> ComposeResult:
        with Horizontal(id="top"):
            with Vertical(id="setup") as setup:
                setup.border_title = "cellapp: profile"
                names = [path.stem for path in self._found]
                yield _helped(OptionList(*names, id="profiles", markup=False, compact=True))
                with Horizontal(classes="field"):
                    yield Label("File")
                    yield _helped(Input(id="profile", placeholder="path of a profile", compact=True))
                with Horizontal(classes="field"):
                    yield Label("Folder")
                    yield _helped(Input(id="folder", placeholder="empty: a new one in logs", compact=True))
                with Horizontal(id="buttons"):
                    yield _helped(Button("Run (F5)", id="run", variant="success", compact=True))
                    yield _helped(Button("Stop (Esc)", id="stop", variant="error", compact=True, disabled=True))
            with _helped(Vertical(id="progress")) as progress:
                progress.border_title = "progress"
                for job in JOBS:
                    with Horizontal(classes="job"):
                        yield Label(job, classes="name")
                        yield ProgressBar(total=1, show_percentage=False, show_eta=False, id=f"{job}-bar")
                        yield Label("", id=f"{job}-count", classes="count", markup=False)
                        yield Label("", id=f"{job}-note", classes="note", markup=False)
        yield _helped(Static("", id="status", markup=False))
        with _helped(TabbedContent(id="results")):
            with TabPane("Log", id="log-pane"):
                yield _helped(RichLog(id="log", wrap=True, min_width=20, max_lines=5000))
            with TabPane("Tables", id="tables-pane"), _helped(VerticalScroll(id="tables")):
                yield Static(_NO_TABLES, markup=False)
        yield Static("", id="hint", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        """Focus the list of profiles, or the path field if the list is empty."""
        if self._found:
            self._say("Select a profile, then Run (F5). Tab moves from field to field.")
            self.query_one("#profiles").focus()
        else:
            self._say(f"No *.yaml found in {self._profiles}; type the path of a profile.")
            self.query_one("#profile").focus()

    def on_unmount(self) -> None:
        """Stop the run however the screen closes: no run continues unseen."""
        self._cancel.cancel()

    def on_descendant_focus(self, event: DescendantFocus) -> None:
        """Show the help of the focused widget; tooltips need a mouse."""
        texts = [_HELP[node.id] for node in event.widget.ancestors_with_self if node.id in _HELP]
        self.query_one("#hint", Static).update(texts[0] if texts else "")

    @on(OptionList.OptionHighlighted, "#profiles")
    def choose(self, event: OptionList.OptionHighlighted) -> None:
        """Put the path of the selected profile into the field."""
        self.query_one("#profile", Input).value = str(self._found[event.option_index])

    @on(OptionList.OptionSelected, "#profiles")
    @on(Input.Submitted)
    def focus_run_button(self) -> None:
        """Enter focuses the Run button; the arms move only when that is pressed."""
        self.query_one("#run").focus()

    # -- keys and buttons ------------------------------------------------------------------------------------------

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Disable actions that are not possible now; an open question takes only its own keys."""
        if action in ("run", "stop", "show", "toggle_full", "quit") and len(self.screen_stack) > 1:
            return False
        if action == "run" and self.running:
            return None
        if action == "stop" and (not self.running or self._cancel.cancelled):
            return None
        return True

    @on(Button.Pressed, "#run")
    def action_run(self) -> None:
        """Start a run in a thread of its own."""
        text = self.query_one("#profile", Input).value.strip()
        if self.running:
            return
        if not text:
            self._say("No profile selected: select one in the list or type its path.", "failed")
            self.query_one("#profile").focus()
            return
        profile = Path(text).expanduser()
        folder = self.query_one("#folder", Input).value.strip()
        self._folder = Path(folder).expanduser() if folder else default_folder(profile.stem)
        self._cancel = JobControl()
        self._last = None
        for job in JOBS:
            self._draw(Progress(job, 0, 1), count="")
        self._show_tables(Static(_NO_TABLES, markup=False))
        self.action_show("log-pane")
        self._say(f"Running {profile} into {self._folder}.", "running")
        # A daemon thread: a device that never answers cannot keep the program from ending.
        self._worker = threading.Thread(
            target=self._work, args=(profile, self._folder, self._cancel), name="run", daemon=True
        )
        self._switch_buttons()
        self.query_one("#stop").focus()
        self._worker.start()

    @on(Button.Pressed, "#stop")
    def action_stop(self) -> None:
        """Request the run to stop."""
        if self.running and not self._cancel.cancelled:
            self._cancel.cancel()
            self._switch_buttons()
            self._say("Stopping at the next step.", "running")

    def action_show(self, pane: str) -> None:
        """Show the log or the tables."""
        self.query_one("#results", TabbedContent).active = pane
        self.query_one("#log" if pane == "log-pane" else "#tables").focus()

    def action_toggle_full(self) -> None:
        """Toggle full screen for log and tables."""
        self.query_one("#top").toggle_class("hidden")
        self.action_show(self.query_one("#results", TabbedContent).active)

    async def action_quit(self) -> None:
        """Quit; with a run in progress, ask first, stop it and wait for its end."""
        if not self.running:
            self.exit(return_code=self._code)
        elif not self._leaving:
            self.push_screen(LeaveScreen(), self._leave)

    def _leave(self, leave: bool | None) -> None:
        self.refresh_bindings()
        if not leave:
            return
        if not self.running:
            self.exit(return_code=self._code)
            return
        self._leaving = True
        self.action_stop()
        self._say(f"Stopping at the next step, then quitting (waiting at most {self._patience_s:.0f} s).", "running")
        self.set_timer(self._patience_s, self._quit_without_run)

    def _quit_without_run(self) -> None:
        if self.running:
            self.exit(
                return_code=UNEXPECTED,
                message=Text(
                    f"The run did not stop within {self._patience_s:.0f} s; cellapp ended without it. Check the cell"
                    f" before you start again; {self._folder} keeps the measured data."
                ),
            )

    # -- the run, in its thread --------------------------------------------------------------------------------------

    def _work(self, profile: Path, folder: Path, cancel: JobControl) -> None:
        with contextlib.ExitStack() as stack:
            stack.push(self._report_failure)  # whatever ends the run is reported to the screen
            self.post_message(RunEnded(self._run(profile, folder, self._listen, cancel)))

    def _listen(self, event: Progress) -> None:
        self.post_message(RunProgressed(event))

    def _report_failure(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if error is not None:
            self.post_message(RunEnded(error))
        return True

    # -- messages of the run, in the thread of the screen ------------------------------------------------------------

    @on(RunProgressed)
    def show_progress(self, message: RunProgressed) -> None:
        """Draw the progress of a step."""
        event = self._last = message.event
        if event.job in JOBS:
            self._draw(event, count=f"{event.done}/{event.total}")
        self._note(f"{event.job} {event.done}/{event.total} {event.note}".rstrip())

    @on(RunEnded)
    def show_end(self, message: RunEnded) -> None:
        """Draw the results, or state in words why there are none."""
        self._worker = None
        ending = message.ending
        if isinstance(ending, WholeRunResult):
            self._code = 0
            self._show_results(ending)
        elif isinstance(ending, Cancelled):
            self._code = STOPPED
            resume = self._how_to_resume()
            self._say(f"Stopped; {resume}." if resume else "Stopped before the plan was made; start again.", "stopped")
        elif isinstance(ending, CellappError):
            self._code = ending.exit_code
            resume = self._how_to_resume() if isinstance(ending, HardwareError) else ""
            self._say(f"{ending}; then {resume}." if resume else str(ending), "failed")
        else:
            self._code = UNEXPECTED
            self._say(_write_error_log(ending, self._folder), "failed")
        self._switch_buttons()
        if self._leaving:  # the shell keeps what the screen can no longer show
            self.exit(return_code=self._code, message=Text(str(self.query_one("#status", Static).content)))
        elif not isinstance(ending, WholeRunResult) and not isinstance(self.screen, LeaveScreen):
            self.query_one("#run").focus()

    def _show_results(self, results: WholeRunResult) -> None:
        found = None if DISCOVER in results.out_of_date else results.discover
        sentences = [] if found is None else [arm.sentence for arm in found.arms.values()]
        outdated = out_of_date_sentences(results)
        for line in (*sentences, *outdated, *results.notes):
            self._note(line)
        folder = Path(results.run)
        page = folder / PAGE_FILE
        self._say(f"Done; the run is in {folder}" + (f", its report in {page}." if page.exists() else "."), "done")
        marks = [Static(sentence, markup=False, classes="outdated") for sentence in outdated]
        verdicts = [Static(sentence, markup=False, classes="verdict") for sentence in sentences]
        notes = [Static(f"Note: {note}", markup=False, classes="note") for note in results.notes]
        drawn = [_draw_table(table) for table in all_tables(results)]
        self._show_tables(*marks, *verdicts, ItemGrid(*drawn, min_column_width=_TABLE_WIDTH), *notes)
        self.query_one("#results", TabbedContent).active = "tables-pane"
        if not isinstance(self.screen, LeaveScreen):
            self.query_one("#tables").focus()

    def _show_tables(self, *widgets: Widget) -> None:
        tables = self.query_one("#tables", VerticalScroll)
        tables.remove_children()
        tables.mount(*widgets)
        tables.scroll_home(animate=False)

    def _how_to_resume(self) -> str:
        """The command that resumes a run which ended early; empty if there is nothing to resume."""
        if self._last is None or (self._last.job == "plan" and self._last.done < self._last.total):
            return ""
        command = _RESUME_COMMANDS.get(self._last.job, _RESUME_COMMANDS["collect"])
        return "continue with: " + command.format(shlex.quote(str(self._folder)))

    def _draw(self, event: Progress, count: str) -> None:
        self.query_one(f"#{event.job}-bar", ProgressBar).update(total=event.total, progress=event.done)
        self.query_one(f"#{event.job}-count", Label).update(count)
        self.query_one(f"#{event.job}-note", Label).update(event.note)

    def _say(self, text: str, state: str = "ready") -> None:
        status = self.query_one("#status", Static)
        status.update(text)
        status.set_classes(state)
        if state != "ready":
            self._note(text)

    def _note(self, text: str) -> None:
        line = Text(f"{datetime.now():%H:%M:%S} ", style="dim").append(text, style="not dim")
        self.query_one("#log", RichLog).write(line)

    def _switch_buttons(self) -> None:
        self.query_one("#run", Button).disabled = self.running
        self.query_one("#stop", Button).disabled = not self.running or self._cancel.cancelled
        self.refresh_bindings()


def _helped(widget: W) -> W:
    widget.tooltip = _HELP[widget.id or ""]
    return widget


def _draw_table(table: Table) -> Vertical:
    """A table with its title. Cells are plain text: Textual would read a unit in brackets as markup."""
    grid: DataTable[Text] = DataTable(cursor_type="none", zebra_stripes=True)
    grid.can_focus = False  # the pane scrolls all tables together
    sides: list[Literal["left", "right"]] = ["right" if column.is_number else "left" for column in table.columns]
    for heading, side in zip(table.headings, sides, strict=True):
        grid.add_column(Text(heading, justify=side))
    for row in table.text_rows():
        grid.add_row(*(Text(cell, justify=side) for cell, side in zip(row, sides, strict=True)))
    return Vertical(Static(table.title, markup=False, classes="title"), grid, classes="table")


def _write_error_log(error: BaseException, folder: Path) -> str:
    """Write the traceback of an unexpected error into the run's folder and return one sentence about it."""
    what = f"Unexpected {type(error).__name__} in the program"
    path = folder / ERROR_LOG
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(traceback.format_exception(error)), encoding="utf-8")
    except OSError as failure:
        return f"{what}: {error}. Its traceback could not be written to {path}: {failure.strerror}."
    return f"{what}; its traceback is in {path}. Measured data are kept."
