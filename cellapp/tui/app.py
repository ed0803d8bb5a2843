"""One screen for one run: choose a profile, start, watch, stop, read the tables. It only calls, listens and draws."""

from __future__ import annotations

import contextlib
import shlex
import threading
import traceback
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import ClassVar, TypeVar

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

from cellapp.discovery.discover import DISCOVER_RESULT
from cellapp.errors import CellappError, HardwareError
from cellapp.pipeline import Outcome, default_folder, run_whole
from cellapp.progress import Cancelled, CancelToken, Listener, Progress
from cellapp.reporting.tables import Table, all_tables

W = TypeVar("W", bound=Widget)
Run = Callable[[Path, Path | None, Listener, CancelToken | None], Outcome]

JOBS = ("plan", "collect", "calibrate", "discover", "push")
ERROR_LOG = "error.log"
STOPPED = 4
UNEXPECTED = 3

_GO_ON = {
    "collect": "cellapp collect {} --resume",
    "calibrate": "cellapp calibrate {}",
    "discover": "cellapp discover {}",
    "push": "cellapp push {} TARGETS --verify",
}
_TABLE_WIDTH = 66
_NO_TABLES = "The tables appear here when a run is done."
_HELP = {
    "profiles": "Profiles found: up and down choose, Enter goes to Run.",
    "profile": "The profile to run: chosen above, or type the path of another one.",
    "folder": "Where the run is stored: a new or empty folder. Left empty: one below logs.",
    "run": "Start: plan, collect, calibrate, discover, push. THE ARMS WILL MOVE. (F5, r)",
    "stop": "Stop at the next step; what was measured is kept. (Escape, s)",
    "progress": "How far each step is: done of all, and what it is doing now.",
    "status": "What is happening now, or how it ended.",
    "results": "Left, right, or l and t: log or tables. f: the whole screen for them.",
    "log": "What happened, newest last: up, down, Page Up and Page Down scroll.",
    "tables": "Errors at held-out stops and at targets: up, down, Page Up, Page Down scroll.",
    "stay": "The run goes on. (n, Escape)",
    "leave": "Stop the run at its next step, wait until it has ended, then quit. (y)",
}


class Stepped(Message):
    """The run made a step."""

    def __init__(self, event: Progress) -> None:
        super().__init__()
        self.event = event


class Ended(Message):
    """The run's thread is through: with an outcome, or with what ended it."""

    def __init__(self, ending: Outcome | BaseException) -> None:
        super().__init__()
        self.ending = ending


class LeaveScreen(ModalScreen[bool]):
    """Asks whether to stop a run in order to quit."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "dismiss(True)", "Stop and quit"),
        Binding("n,escape", "dismiss(False)", "Go on"),
        Binding("left,right", "app.focus_next", show=False),
    ]

    def compose(self) -> ComposeResult:
        with Vertical(id="question"):
            yield Static("A run is under way. Stop it at its next step and quit?", markup=False)
            with Horizontal(id="answers"):
                yield _helped(Button("Go on (n)", id="stay", compact=True))
                yield _helped(Button("Stop and quit (y)", id="leave", variant="error", compact=True))

    @on(Button.Pressed)
    def answer(self, event: Button.Pressed) -> None:
        """Hand the answer back."""
        event.stop()
        self.dismiss(event.button.id == "leave")


class CellApp(App[None]):
    """The screen.

    Parameters
    ----------
    profiles : Path
        Folder whose ``*.yaml`` are offered.
    run : callable
        What is called in a thread of its own, as ``run_whole``.
    patience_s : float
        How long quitting waits for a run to stop before the program leaves it behind.
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
        self._cancel = CancelToken()
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
        """Begin at the list of profiles, or at the path where there are none."""
        if self._found:
            self._say("Choose a profile, then Run (F5). Tab goes from field to field.")
            self.query_one("#profiles").focus()
        else:
            self._say(f"There is no *.yaml in {self._profiles}; type the path of a profile.")
            self.query_one("#profile").focus()

    def on_unmount(self) -> None:
        """However the screen goes, no run goes on unseen."""
        self._cancel.cancel()

    def on_descendant_focus(self, event: DescendantFocus) -> None:
        """Show the help of what has the keyboard; tooltips are for the mouse."""
        texts = [_HELP[node.id] for node in event.widget.ancestors_with_self if node.id in _HELP]
        self.query_one("#hint", Static).update(texts[0] if texts else "")

    @on(OptionList.OptionHighlighted, "#profiles")
    def choose(self, event: OptionList.OptionHighlighted) -> None:
        """Put the chosen profile's path where it can be seen and changed."""
        self.query_one("#profile", Input).value = str(self._found[event.option_index])

    @on(OptionList.OptionSelected, "#profiles")
    @on(Input.Submitted)
    def to_button(self) -> None:
        """Enter leads on to the button; arms move only when that is pressed."""
        self.query_one("#run").focus()

    # -- keys and buttons ------------------------------------------------------------------------------------------

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Grey out what cannot be done now, and leave only its own keys to a question."""
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
            self._say("Which profile? Choose one in the list or type its path.", "failed")
            self.query_one("#profile").focus()
            return
        profile = Path(text).expanduser()
        folder = self.query_one("#folder", Input).value.strip()
        self._folder = Path(folder).expanduser() if folder else default_folder(profile.stem)
        self._cancel = CancelToken()
        self._last = None
        for job in JOBS:
            self._draw(Progress(job, 0, 1), count="")
        self._show_tables(Static(_NO_TABLES, markup=False))
        self.action_show("log-pane")
        self._say(f"Running {profile} into {self._folder}.", "running")
        # A daemon: a device that never answers cannot keep the program from ending.
        self._worker = threading.Thread(
            target=self._work, args=(profile, self._folder, self._cancel), name="run", daemon=True
        )
        self._switch_buttons()
        self.query_one("#stop").focus()
        self._worker.start()

    @on(Button.Pressed, "#stop")
    def action_stop(self) -> None:
        """Ask the run to stop."""
        if self.running and not self._cancel.cancelled:
            self._cancel.cancel()
            self._switch_buttons()
            self._say("Stopping at the next step.", "running")

    def action_show(self, pane: str) -> None:
        """Turn to the log or the tables."""
        self.query_one("#results", TabbedContent).active = pane
        self.query_one("#log" if pane == "log-pane" else "#tables").focus()

    def action_toggle_full(self) -> None:
        """All of the screen for log and tables, and back."""
        self.query_one("#top").toggle_class("hidden")
        self.action_show(self.query_one("#results", TabbedContent).active)

    async def action_quit(self) -> None:
        """Quit; with a run under way, ask, stop it and wait for its end first."""
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
        self.set_timer(self._patience_s, self._lose_patience)

    def _lose_patience(self) -> None:
        if self.running:
            self.exit(
                return_code=UNEXPECTED,
                message=Text(
                    f"The run did not stop within {self._patience_s:.0f} s and was left behind. Look at the cell"
                    f" before you start again; {self._folder} keeps what was measured."
                ),
            )

    # -- the run, in its thread --------------------------------------------------------------------------------------

    def _work(self, profile: Path, folder: Path, cancel: CancelToken) -> None:
        with contextlib.ExitStack() as stack:
            stack.push(self._report_failure)  # whatever ends a run, the screen must learn of it
            outcome = self._run(profile, folder, self._listen, cancel)
            self.post_message(Ended(outcome))

    def _listen(self, event: Progress) -> None:
        self.post_message(Stepped(event))

    def _report_failure(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if error is not None:
            self.post_message(Ended(error))
        return True

    # -- what the run tells, in the screen's thread --------------------------------------------------------------------

    @on(Stepped)
    def show_step(self, message: Stepped) -> None:
        """Draw a step."""
        event = self._last = message.event
        if event.job in JOBS:
            self._draw(event, count=f"{event.done}/{event.total}")
        self._note(f"{event.job} {event.done}/{event.total} {event.note}".rstrip())

    @on(Ended)
    def show_end(self, message: Ended) -> None:
        """Draw the outcome, or say in words why there is none."""
        self._worker = None
        ending = message.ending
        if isinstance(ending, Outcome):
            self._code = 0
            self._show_outcome(ending)
        elif isinstance(ending, Cancelled):
            self._code = STOPPED
            way = self._way_on()
            self._say(f"Stopped; {way}." if way else "Stopped before there was a plan; start again.", "stopped")
        elif isinstance(ending, CellappError):
            self._code = ending.exit_code
            way = self._way_on() if isinstance(ending, HardwareError) else ""
            self._say(f"{ending}; then {way}." if way else str(ending), "failed")
        else:
            self._code = UNEXPECTED
            self._say(_write_down(ending, self._folder), "failed")
        self._switch_buttons()
        if self._leaving:  # the shell keeps what the screen can no longer show
            self.exit(return_code=self._code, message=Text(str(self.query_one("#status", Static).content)))
        elif not isinstance(ending, Outcome) and not isinstance(self.screen, LeaveScreen):
            self.query_one("#run").focus()

    def _show_outcome(self, outcome: Outcome) -> None:
        arms = outcome.results.get(DISCOVER_RESULT, {"arms": {}})["arms"]
        sentences = [arm["sentence"] for arm in arms.values()]
        for line in (*sentences, *outcome.notes):
            self._note(line)
        page = outcome.folder / "report.html"
        self._say(
            f"Done; the run is in {outcome.folder}" + (f", its report in {page}." if page.exists() else "."), "done"
        )
        notes = [Static(f"Note: {note}", markup=False, classes="note") for note in outcome.notes]
        verdicts = [Static(sentence, markup=False, classes="verdict") for sentence in sentences]
        drawn = [_drawn(table) for table in all_tables(outcome.results)]
        self._show_tables(*verdicts, ItemGrid(*drawn, min_column_width=_TABLE_WIDTH), *notes)
        self.query_one("#results", TabbedContent).active = "tables-pane"
        if not isinstance(self.screen, LeaveScreen):
            self.query_one("#tables").focus()

    def _show_tables(self, *widgets: Widget) -> None:
        tables = self.query_one("#tables", VerticalScroll)
        tables.remove_children()
        tables.mount(*widgets)
        tables.scroll_home(animate=False)

    def _way_on(self) -> str:
        """How a person goes on with a run that ended early: by hand from the step that it was in."""
        if self._last is None or (self._last.job == "plan" and self._last.done < self._last.total):
            return ""
        command = _GO_ON.get(self._last.job, _GO_ON["collect"])
        return "go on with: " + command.format(shlex.quote(str(self._folder)))

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


def _drawn(table: Table) -> Vertical:
    """A table with its title; texts go in as they are, for a unit in brackets would be read as markup."""
    first, *others = table.columns
    grid: DataTable[Text] = DataTable(cursor_type="none", zebra_stripes=True)
    grid.can_focus = False  # the pane scrolls, all tables together
    grid.add_column(Text(first))
    for column in others:
        grid.add_column(Text(column, justify="right"))
    for name, *numbers in table.rows:
        grid.add_row(Text(name), *(Text(number, justify="right") for number in numbers))
    return Vertical(Static(table.title, markup=False, classes="title"), grid, classes="table")


def _write_down(error: BaseException, folder: Path) -> str:
    """Write an error that nobody foresaw where it can be read in full, and say so in a sentence."""
    what = f"The program itself failed ({type(error).__name__})"
    path = folder / ERROR_LOG
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(traceback.format_exception(error)), encoding="utf-8")
    except OSError as failure:
        return f"{what}: {error}. Its full text could not be written to {path}: {failure.strerror}."
    return f"{what}; its full text is in {path}. What was measured is kept."
