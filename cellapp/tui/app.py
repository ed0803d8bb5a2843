"""The screen of one run: choose a profile, start, watch, pause, stop, read the tables. ``run_whole`` does all work.

The key that stops calls the brakes in the thread of the screen. Events of the run wait in a queue of their own and are
drawn a few at a time: however many there are, a key is handled at once.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections import deque
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import ClassVar

from rich.text import Text
from textual import on
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, ItemGrid, Vertical, VerticalScroll
from textual.css.query import NoMatches
from textual.events import DescendantFocus
from textual.message import Message
from textual.widget import Widget
from textual.widgets import (
    Button,
    Footer,
    Input,
    Label,
    OptionList,
    RichLog,
    Static,
    TabbedContent,
    TabPane,
)

from cellapp.control import Aborted, JobControl
from cellapp.errors import CellappError, HardwareError
from cellapp.pipeline import default_folder, run_whole
from cellapp.progress import Cancelled, JobState, Progress, StateChange, StopReport
from cellapp.reporting.discovery_text import explanation_text
from cellapp.reporting.page import PAGE_FILE
from cellapp.reporting.progress_words import detail_words
from cellapp.reporting.tables import all_tables, out_of_date_sentences
from cellapp.results import DISCOVER, WholeRunResult
from cellapp.signals import available, watch_signals
from cellapp.tui.dialogs import ConfirmScreen, LeaveScreen
from cellapp.tui.endings import how_to_resume, write_error_log
from cellapp.tui.progress_panel import ProgressPanel
from cellapp.tui.widgets import HELP, draw_table, helped

Run = Callable[..., WholeRunResult]
"""``run_whole``, or what stands in for it."""

STOPPED = 4
UNEXPECTED = 3
"""Exit codes: stopped and resumable; an unexpected error, after which somebody must look at the cell."""

_TABLE_WIDTH = 66
"""Narrowest column of tables [characters]: an accuracy table fits, and a wide screen shows two side by side."""
_REQUESTS = ("stop", "pause", "resume", "abort")
_BEHIND_QUESTIONS = ("run", "pause", "resume", "show", "toggle_full", "quit")
"""Actions that an open question hides."""
_ENDING = available("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
_PAUSING = available("SIGTSTP")
_DRAWING_S = 0.05
_MOST_DRAWN = 30
"""Events that are drawn at a time: each takes less than a millisecond."""
_MOST_WAITING = 1000
"""Events that wait to be drawn; a faster run loses the oldest ones here, its log in the run file has all."""
_ANSWER_S = 0.1
"""How often a run that waits for an answer looks whether it is to end."""
_NO_TABLES = "Tables appear here when a run has ended."


class MotionAsked(Message):
    """The run asks before its first motion; ``answer`` takes what the person decides."""

    def __init__(self, words: str, answer: Callable[[bool], None]) -> None:
        super().__init__()
        self.words, self.answer = words, answer


class LeaveAsked(Message):
    """The terminal was closed, or the system ends this program."""


class RunEnded(Message):
    """The thread of the run ended, with a result or an exception."""

    def __init__(self, ending: WholeRunResult | BaseException) -> None:
        super().__init__()
        self.ending = ending


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
        Binding("escape,s", "stop", "STOP", priority=True),
        Binding("p", "pause", "Pause"),
        Binding("c", "resume", "Resume"),
        Binding("x", "abort", "Abort"),
        Binding("ctrl+x", "abort", show=False, priority=True),
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
        self._control = JobControl(holds=True)
        self._events: deque[Progress] = deque(maxlen=_MOST_WAITING)
        self._signals = contextlib.ExitStack()
        self._worker: threading.Thread | None = None
        self._folder = Path()
        self._last: Progress | None = None
        self._leaving = False
        self._code = 0

    @property
    def _panel(self) -> ProgressPanel:
        return self.query_one(ProgressPanel)

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
                yield helped(OptionList(*names, id="profiles", markup=False, compact=True))
                with Horizontal(classes="field"):
                    yield Label("File")
                    yield helped(Input(id="profile", placeholder="path of a profile", compact=True))
                with Horizontal(classes="field"):
                    yield Label("Folder")
                    yield helped(Input(id="folder", placeholder="empty: a new one in logs", compact=True))
                with Horizontal(id="buttons"):
                    yield helped(Button("Run (F5)", id="run", variant="success", compact=True))
                    yield helped(Button("STOP (Esc)", id="stop", variant="error", compact=True, disabled=True))
                with Horizontal(id="requests"):
                    for verb, key in (("pause", "p"), ("resume", "c"), ("abort", "x")):
                        label = f"{verb.capitalize()} ({key})"
                        yield helped(Button(label, id=verb, compact=True, disabled=True))
            yield helped(ProgressPanel(id="progress"))
        yield helped(Static("", id="status", markup=False))
        with helped(TabbedContent(id="results")):
            with TabPane("Log", id="log-pane"):
                yield helped(RichLog(id="log", wrap=True, min_width=20, max_lines=5000))
            with TabPane("Tables", id="tables-pane"), helped(VerticalScroll(id="tables")):
                yield Static(_NO_TABLES, markup=False)
        yield Static("", id="hint", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        """Focus the list of profiles, or the path field if the list is empty."""
        self.set_interval(_DRAWING_S, self._draw_events)
        if threading.current_thread() is threading.main_thread():
            # after Textual has set its own: that of Ctrl-Z would freeze the program while arms move
            self._signals.enter_context(watch_signals((*_ENDING, *_PAUSING), self._on_signal, lambda *_: None))
        if self._found:
            self._say("Select a profile, then Run (F5). Tab moves from field to field.")
            self.query_one("#profiles").focus()
        else:
            self._say(f"No *.yaml found in {self._profiles}; type the path of a profile.")
            self.query_one("#profile").focus()

    def on_unmount(self) -> None:
        """Brake all arms and end the run however the screen closes: no run continues unseen."""
        self._control.leave()
        self._signals.close()

    def wait_for_run(self) -> None:
        """Wait, for a bounded time, until a run that was left has brought its arms to rest."""
        if self._worker is not None:
            self._worker.join(self._patience_s)

    def _on_signal(self, number: int) -> None:
        """In the thread that watches the signals."""
        if number in _ENDING:
            self._control.leave()
            self.post_message(LeaveAsked())
        elif self._control.request == "pause":
            self._control.resume()
        else:
            self._control.pause()

    @on(LeaveAsked)
    def leave_at_once(self) -> None:
        """Quit as if the question had been answered."""
        self._leave(True)

    def on_descendant_focus(self, event: DescendantFocus) -> None:
        """Show the help of the focused widget; tooltips need a mouse."""
        ids = [node.id or "" for node in event.widget.ancestors_with_self]
        texts = [HELP[name] for name in ids if name in HELP]
        with contextlib.suppress(NoMatches):  # the screen goes away
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
        """Disable actions that are not possible now; over an open question only stop and abort remain."""
        if action in _BEHIND_QUESTIONS and len(self.screen_stack) > 1:
            return False
        if action in ("run", *_REQUESTS) and not self._possible(action):
            return None
        return True

    def _possible(self, action: str) -> bool:
        """Whether a run can be started, or a request be made of the present one."""
        request = self._control.request
        return {
            "run": not self.running,
            "stop": self.running,  # again and again: braking twice does no harm
            "pause": self.running and request != "abort",
            "resume": self.running and request in ("pause", "stop"),
            "abort": self.running and request != "abort",
        }[action]

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
        self._control = JobControl(holds=True)
        self._last = None
        self._panel.begin()
        self._show_tables(Static(_NO_TABLES, markup=False))
        self.action_show("log-pane")
        self._say(f"Running {profile} into {self._folder}.", "running")
        self._panel.show_state("running")
        # A daemon thread: a device that never answers cannot keep the program from ending.
        self._worker = threading.Thread(
            target=self._work, args=(profile, self._folder, self._control), name="run", daemon=True
        )
        self._switch_buttons()
        self.query_one("#stop").focus()
        self._worker.start()

    @on(Button.Pressed, "#stop")
    def action_stop(self) -> None:
        """Brake all arms now."""
        if not self._possible("stop"):
            return
        arms = self._control.has_brakes
        self._control.stop()  # before anything is drawn
        self._refuse_motion()
        if self._control.cancelled:
            self._requested("Stopping: the arms brake, the run ends." if arms else "Stopping at the next step.")
        else:
            self._requested("STOP: all arms brake. c: resume when the cell is clear; x: abort.", "stopped")

    @on(Button.Pressed, "#pause")
    def action_pause(self) -> None:
        """Let the run rest after the present stop; the second time, resume. It does not resume a stopped run."""
        if self._control.request == "pause":
            self.action_resume()
        elif self._control.request == "stop":
            self._say("Stopped, not paused. c: resume when the cell is clear; x: abort.", "running")
        elif self._possible("pause"):
            self._control.pause()
            self._requested("Pausing: the arms rest after the present stop. p or c: resume; Escape: stop.", "pausing")

    @on(Button.Pressed, "#resume")
    def action_resume(self) -> None:
        """Let a paused or stopped run continue."""
        if self._possible("resume"):
            self._control.resume()
            self._requested("Resuming.", "running")

    @on(Button.Pressed, "#abort")
    def action_abort(self) -> None:
        """Brake all arms now and end the run."""
        if self._possible("abort"):
            self._control.abort()
            self._refuse_motion()
            self._requested("Aborting: all arms brake, the run ends.", "aborted")

    def _requested(self, text: str, state: JobState | None = None) -> None:
        self._say(text, "running")
        if state is not None:
            self._panel.show_state(state)
        self._switch_buttons()

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
        self._control.leave()
        self._refuse_motion()
        self._switch_buttons()
        self._say(f"Stopping, then quitting (waiting at most {self._patience_s:.0f} s).", "running")
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

    def _work(self, profile: Path, folder: Path, control: JobControl) -> None:
        def ask(words: str) -> bool:
            answers: queue.SimpleQueue[bool] = queue.SimpleQueue()
            self.post_message(MotionAsked(words, answers.put))
            while control.request in ("none", "pause"):
                with contextlib.suppress(queue.Empty):
                    return answers.get(timeout=_ANSWER_S)
            return False

        with contextlib.ExitStack() as stack:
            stack.push(self._report_failure)  # whatever ends the run is reported to the screen
            self.post_message(RunEnded(self._run(profile, folder, self._events.append, control, ask=ask)))

    def _report_failure(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if error is not None:
            self.post_message(RunEnded(error))
        return True

    # -- messages of the run, in the thread of the screen ------------------------------------------------------------

    @on(MotionAsked)
    def ask_before_motion(self, message: MotionAsked) -> None:
        """Show the first motion and ask for the profile's name."""
        name = Path(self.query_one("#profile", Input).value).stem
        self.push_screen(ConfirmScreen(message.words, name), lambda allowed: message.answer(bool(allowed)))

    def _refuse_motion(self) -> None:
        """Close the question before the first motion: a stop is an answer."""
        if isinstance(self.screen, ConfirmScreen):
            self.screen.dismiss(False)

    def _draw_events(self, most: int = _MOST_DRAWN) -> None:
        """Draw the oldest events of the run that are not drawn yet."""
        with contextlib.suppress(NoMatches):  # the screen is going away
            for _ in range(min(len(self._events), most)):
                self._show_progress(self._events.popleft())

    def _show_progress(self, event: Progress) -> None:
        self._last = event
        self._panel.show(event)
        match event.detail:
            case None:
                self._note(f"{event.job} {event.done}/{event.total} {event.note}".rstrip())
            case StopReport():
                pass  # the panel shows the newest; the log would have a line for each stop and arm
            case StateChange(state):
                self._say(f"{event.job}: {detail_words(event.detail)}", "running" if state == "running" else "stopped")
                self._panel.show_state(state)
                self._switch_buttons()
            case _:
                self._note(f"{event.job}: {detail_words(event.detail)}")

    @on(RunEnded)
    def show_end(self, message: RunEnded) -> None:
        """Draw the results, or state in words why there are none."""
        self._draw_events(len(self._events))
        self._worker = None
        if not self.query("#status"):  # the screen is going away
            return
        self._panel.show_state(None)
        ending = message.ending
        if isinstance(ending, WholeRunResult):
            self._code = 0
            self._show_results(ending)
        elif isinstance(ending, Cancelled):
            self._code = STOPPED
            word = "Aborted" if isinstance(ending, Aborted) else "Stopped"
            resume = how_to_resume(self._last, self._folder)
            self._say(f"{word}; {resume}." if resume else f"{word} before the plan was made; start again.", "stopped")
        elif isinstance(ending, CellappError):
            self._code = ending.exit_code
            resume = how_to_resume(self._last, self._folder) if isinstance(ending, HardwareError) else ""
            self._say(f"{ending}; then {resume}." if resume else str(ending), "failed")
        else:
            self._code = UNEXPECTED
            self._say(write_error_log(ending, self._folder), "failed")
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
        page = Path(results.run) / PAGE_FILE
        self._say(f"Done; the run is in {page.parent}" + (f", its report in {page}." if page.exists() else "."), "done")
        marks = [Static(sentence, markup=False, classes="outdated") for sentence in outdated]
        verdicts = [Static(sentence, markup=False, classes="verdict") for sentence in sentences]
        notes = [Static(f"Note: {note}", markup=False, classes="note") for note in results.notes]
        meanings = [] if found is None else [Static(explanation_text(found), markup=False, classes="meaning")]
        grid = ItemGrid(*map(draw_table, all_tables(results)), min_column_width=_TABLE_WIDTH)
        self._show_tables(*marks, *verdicts, grid, *meanings, *notes)
        self.query_one("#results", TabbedContent).active = "tables-pane"
        if not isinstance(self.screen, LeaveScreen):
            self.query_one("#tables").focus()

    def _show_tables(self, *widgets: Widget) -> None:
        tables = self.query_one("#tables", VerticalScroll)
        tables.remove_children()
        tables.mount(*widgets)
        tables.scroll_home(animate=False)

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
        self.query_one("#run", Button).disabled = not self._possible("run")
        for action in _REQUESTS:
            self.query_one(f"#{action}", Button).disabled = not self._possible(action)
        self.refresh_bindings()
