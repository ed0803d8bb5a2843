"""Shared parts of all commands: progress bars, cancellation, tables and JSON."""

from __future__ import annotations

import contextlib
import os
import queue
import shutil
import signal
import sys
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from cellapp.commands.view.parts import Parts, printed
from cellapp.ground.control import Aborted, JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.progress import Notice, Progress, StateChange, Suspicion, eta_words, in_lines
from cellapp.ground.signals import HANGUP, INTERRUPTS, available, ended_by, watch_signals
from cellapp.interfaces.cli.command_outputs import current_outputs

if TYPE_CHECKING:
    from cellapp.commands.view.table import Table
    from cellapp.ground.results import Result

_BY_KEY = available("SIGINT", "SIGBREAK")
"""Signals of Ctrl-C; any other signal that ends the job is recorded under its own name."""
_SUSPENDS = available("SIGTSTP")
_LAST_WORDS_S = 1.0
"""How long the end of a job waits until its messages are printed."""


class CommandJob:
    """One command: progress bars, reaction to signals, tables and sentences, and the JSON.

    Ctrl-C and SIGTERM stop: all arms brake at once, and the job ends. The second one aborts: it ends at once. A closed
    terminal stops. Ctrl-Z pauses after the current stop if arms are open; the second one resumes that pause.

    Raises
    ------
    InputError
        If a file that the command names may not be written; nothing was done then.
    """

    def __init__(self, json_file: str | None) -> None:
        called = current_outputs()
        called.check()
        self._filled = called.filled
        self.outputs = called.outputs
        self.control = JobControl(self.listen)
        self._json_file = json_file
        self._bars: Any = None
        self._tasks: dict[str, Any] = {}
        self._in_lines = in_lines(self._announce)
        self._signals = contextlib.ExitStack()
        self._interrupts = 0
        self._messages: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._writer = threading.Thread(target=self._print_messages, name="messages", daemon=True)

    def __enter__(self) -> CommandJob:
        self._writer.start()
        numbers = (*INTERRUPTS, *HANGUP, *_SUSPENDS)
        self._signals.enter_context(watch_signals(numbers, self._react, self._interrupt))
        return self

    def __exit__(self, *exception: object) -> None:
        self._signals.close()  # first: the reaction to a signal may still print something
        self._messages.put(None)
        self._writer.join(_LAST_WORDS_S)
        self._stop_bars()

    def listen(self, event: Progress) -> None:
        """Draw one bar for each job on standard error, and print what a person must know.

        If standard error is no terminal, print the progress of a long job once a minute.
        """
        match event.detail:
            case StateChange(state, reason):
                self._announce(f"{event.job}: {state}: {reason}")
            case Suspicion(kind, text):
                self._announce(f"{event.job}: suspicion, {kind}: {text}")
            case Notice(text):
                self._announce(f"{event.job}: {text}")
        if not sys.stderr.isatty():
            self._in_lines(event)
            return
        if self._bars is None:
            self._start_bars()
        if event.job not in self._tasks:
            self._tasks[event.job] = self._bars.add_task(event.job, total=event.total, note="", eta="")
        task, eta = self._tasks[event.job], eta_words(event.eta_s)
        self._bars.update(task, completed=event.done, total=event.total, eta=eta)
        if event.note or event.detail is None:  # the note of a step stands until the next step
            self._bars.update(task, note=event.note)

    def say(self, line: str) -> None:
        """Print a line on standard output, or on standard error if standard output carries the JSON."""
        self._print(line, sys.stderr if self._json_file == "-" else sys.stdout)

    def warn(self, line: str) -> None:
        """Print a line that a person must see on standard error, whatever standard output is used for."""
        self._print(line, sys.stderr)

    def _print(self, line: str, stream: TextIO) -> None:
        self._stop_bars()
        print(self._filled(line), file=stream, flush=True)

    def show_view(self, view: Parts, rest: str = "") -> None:
        """Print the tables and lines of a view in their order; on a terminal as much as fits, if ``rest`` names it."""
        parts: Iterable[Table | str] = printed(view, self._filled)
        if rest and (sys.stderr if self._json_file == "-" else sys.stdout).isatty():
            from cellapp.interfaces.render.terminal import shortened

            parts = shortened(view, self._filled, shutil.get_terminal_size().columns, rest)
        for part in parts:
            if isinstance(part, str):
                self.say(part)
            else:
                self._show(part)

    def _show(self, table: Table) -> None:
        """Print a table on the same stream as ``say``."""
        from rich.console import Console

        from cellapp.interfaces.render.terminal import TerminalTable

        self._stop_bars()
        Console(stderr=self._json_file == "-").print(TerminalTable(table, cut=False), crop=False)

    @property
    def writes_json(self) -> bool:
        """Whether ``--json`` was given."""
        return self._json_file is not None

    def result(self, result: Result) -> None:
        """Write the result as JSON to the destination of ``--json``, if given."""
        if self._json_file is None:
            return
        text = result.to_json(indent=1) + "\n"
        if self._json_file != "-":
            self.outputs.write_text(Path(self._json_file), text, "--json")
            return
        try:
            sys.stdout.write(text)
            sys.stdout.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            raise InputError(f"--json: standard output cannot be written ({error.strerror})") from None

    def _react(self, number: int) -> None:
        """React to a signal, in the thread that watches the signals; brakes come before any message."""
        arms = self.control.has_brakes
        ends = self.control.request in ("stop", "abort")
        if ends and number in INTERRUPTS:
            self.control.abort()
            self._announce("abort: the job ends at once")
        elif ends and number in HANGUP:
            return  # the stop stands
        elif number in INTERRUPTS or number in HANGUP:
            if number in _BY_KEY:
                self.control.stop()
            else:
                self.control.leave(ended_by(number))
            what = "all arms brake now; the job then ends" if arms else "the job ends at its next step"
            self._announce(f"stop: {what}; what is stored stays. Once more: end at once")
        elif number in _SUSPENDS and not arms:
            os.kill(os.getpid(), signal.SIGSTOP)  # nothing can move: the default action of Ctrl-Z
        elif self.control.request == "pause":
            self.control.resume()
            self._announce("resume: the job continues")
        elif self.control.request == "none":
            self.control.pause()
            self._announce("pause: the arms rest after this stop. Ctrl-Z again: resume; Ctrl-C: stop")

    def _interrupt(self, number: int, frame: object) -> None:
        """End the job at the second interrupt, wherever the main thread is. ``_react`` does everything urgent."""
        if number in INTERRUPTS:
            self._interrupts += 1
            if self._interrupts > 1 or self.control.request == "abort":  # Python may report two signals as one
                raise Aborted("aborted at once")

    def _announce(self, text: str) -> None:
        """Print a line on standard error, above the bars; from any thread.

        A separate thread writes it: a terminal that blocks output must not delay the reaction to the next signal.
        """
        self._messages.put(self._filled(text))

    def _print_messages(self) -> None:
        while (text := self._messages.get()) is not None:
            bars = self._bars
            with contextlib.suppress(OSError):  # the terminal was closed
                if bars is None:
                    print(f"cellapp: {text}", file=sys.stderr, flush=True)
                else:
                    bars.console.print(f"cellapp: {text}", markup=False, highlight=False)

    def _start_bars(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bars

        self._bars = Bars(
            TextColumn("{task.description:12}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[eta]}"),
            TextColumn("{task.fields[note]}"),
            console=Console(stderr=True),
        )
        self._bars.start()

    def _stop_bars(self) -> None:
        if self._bars is not None:
            with contextlib.suppress(OSError):  # the terminal was closed
                self._bars.stop()
            self._bars, self._tasks = None, {}
