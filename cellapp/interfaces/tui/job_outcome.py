"""Words for a person about how a job ended.

Exit on request of the system: the terminal was closed, or the program must end. Ctrl-Z pauses instead.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cellapp.commands.run.request import VERB as RUN
from cellapp.ground.control import Aborted
from cellapp.ground.errors import CellappError, CheckFailed, HardwareError, InputError
from cellapp.ground.outputs import RENEWED
from cellapp.ground.progress import Cancelled, Progress
from cellapp.ground.signals import HANGUP, INTERRUPTS, TERMINAL_CLOSED, available, ended_by, watch_signals
from cellapp.interfaces.tui.host import Host, LeaveAsked, Severity
from cellapp.interfaces.tui.jobs import JobEnded
from cellapp.interfaces.tui.keys import way_to
from cellapp.interfaces.tui.live_run import Detached

ERROR_LOG = "error.log"
REPORT_FILE = "report.html"
"""Same name as in ``cellapp.cell.run.sqlite_file``, whose import would slow down the start."""
STOPPED = 4
UNEXPECTED = 3
"""Exit codes: stopped and resumable; an unexpected error, after which somebody must look at the cell."""

_RESUMABLE = ("collect", "calibrate", "discover", "push", "verify")
"""Jobs that continue where they were, or can be repeated without loss."""
_PLANS = ("plan", "compare")
"""Last events of planning, random and designed; an unfinished plan is not stored."""


@dataclass(frozen=True)
class Ending:
    """End of a job: a sentence, its severity, and the exit code of the program if it quits then."""

    text: str
    severity: Severity
    code: int


def ending_of(ended: JobEnded, last: Progress | None) -> Ending:
    """Return the end of a job in words; ``last`` is its newest event."""
    folder, ending = ended.job.folder, ended.ending
    if not isinstance(ending, BaseException):
        return _done(ended)
    if isinstance(ending, Detached):
        goes_on = f"'{ended.job.name}' goes on in process {ended.job.process}"
        return Ending(f"{goes_on}. Open {folder} again to stop it.", "information", 0)
    resume = how_to_resume(last, folder)
    if isinstance(ending, Cancelled):
        word = "Aborted" if isinstance(ending, Aborted) else "Stopped"
        return Ending(f"{word}; {resume}." if resume else f"{word}; nothing is left to resume.", "warning", STOPPED)
    if isinstance(ending, CellappError):
        more = f"; then {resume}." if resume and isinstance(ending, HardwareError) else ""
        return Ending(f"{ending}{more}", "error", ending.exit_code)
    return Ending(_unexpected(ending, folder), "error", UNEXPECTED)


def _done(ended: JobEnded) -> Ending:
    """Return the end of a completed job; if a check did not hold, with the exit code of the command."""
    job, view = ended.job, ended.view
    where = "" if job.folder is None else f"; the run is in {job.folder}"
    if job.process is not None:
        return Ending(f"{job.name}: process {job.process} has ended it{where}.", "information", 0)
    if job.folder is not None and job.name == RUN.name:
        where = f"; the report is {job.folder / REPORT_FILE}"
    if view.refused:
        return Ending(f"{job.name}: {view.refused}{where}.", "error", InputError.exit_code)
    if view.failed:
        checks = view.checks or (job.verb.checks if job.verb is not None else "")
        what = "" if checks in ("", job.name) else f"{checks}: "
        return Ending(f"{job.name}: {what}{'; '.join(view.failed).rstrip('.')}{where}.", "error", CheckFailed.exit_code)
    held = f"; {view.held.rstrip('.')}" if view.held else ""
    return Ending(f"{job.name}: done{held}{where}.", "information", 0)


def how_to_resume(last: Progress | None, folder: Path | None) -> str:
    """Return how to continue after a job whose last event was ``last``; empty if there is nothing to resume."""
    if last is None or folder is None:
        return ""
    job = "collect" if last.job in _PLANS and last.done >= last.total else last.job
    return f"{way_to('push' if job == 'verify' else job)} go on" if job in _RESUMABLE else ""


def left_behind(name: str, patience_s: float) -> str:
    """Return what a person must know about a job that did not stop before the program ended."""
    return (
        f"'{name}' did not stop within {patience_s:.0f} s; cellapp ended without it. Check the cell before you start"
        " again; the run keeps the measured data."
    )


def _unexpected(error: BaseException, folder: Path | None) -> str:
    """Write the traceback of an unexpected error into the run's folder and return one sentence about it."""
    what = f"Unexpected {type(error).__name__} in the program"
    path = (folder or Path()) / ERROR_LOG
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        RENEWED.write_text(path, "".join(traceback.format_exception(error)))
    except (OSError, CellappError) as failure:
        return f"{what}: {error}. Its traceback could not be written to {path}: {failure}."
    return f"{what}; its traceback is in {path}. Measured data are kept."


def forget_terminal() -> None:
    """Redirect output to the null device: the terminal was closed, and writing to it would fail."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    os.close(nowhere)


LEFT = "a person left the application"
ENDED = "the terminal application ended"
"""Cause of the halt that a run records."""
_PAUSING = available("SIGTSTP")
_LAST_WORDS_S = 5.0
"""Time limit for leaving the screen after the end of the job; usually about 0.1 s."""
_LAST_WRITES_S = 0.5
"""The same if the terminal is gone: nobody reads it, and the next start waits for the files that this one holds."""


_STALLED_S, _LOOK_S = 1.5, 0.05


class Leaving:
    """Stops the job, then ends the application.

    Parameters
    ----------
    app : Host
    ends_process : bool
        Whether a signal that ends the program ends the process even if the screen cannot be left.
    """

    def __init__(self, app: Host, *, ends_process: bool) -> None:
        self._app, self._ends_process = app, ends_process
        self._signals = contextlib.ExitStack()

    def watch(self) -> None:
        """Handle signals, in the main thread, after Textual has set its handlers: Ctrl-Z would freeze the program."""
        if threading.current_thread() is threading.main_thread():
            self._signals.enter_context(watch_signals((*INTERRUPTS, *HANGUP, *_PAUSING), self._react, lambda *_: None))

    def close(self) -> None:
        """Stop handling signals."""
        self._signals.close()

    @contextlib.contextmanager
    def lent(self) -> Iterator[None]:
        """Leave Ctrl-C and Ctrl-Z to another program that has the terminal meanwhile. Call it in the main thread."""
        self.close()
        own = {number: signal.signal(number, signal.SIG_IGN) for number in available("SIGINT")}
        own |= {number: signal.signal(number, signal.SIG_DFL) for number in _PAUSING}
        try:
            yield
        finally:
            for number, handler in own.items():
                signal.signal(number, handler)
            self.watch()

    def _react(self, number: int) -> None:
        """React to a signal, in the thread that watches the signals."""
        control = self._app.jobs.control
        if number in HANGUP:
            self.close_terminal()
        elif number in INTERRUPTS:
            control.leave(ended_by(number))
            self.end_if_stalled(ended_by(number), until_ended=True)
            self._end(_LAST_WORDS_S)
        elif control.request == "pause":
            control.resume()
        else:
            control.pause()

    def close_terminal(self) -> None:
        """Leave because the terminal is gone; from any thread."""
        self._app.jobs.control.leave(TERMINAL_CLOSED)
        forget_terminal()
        self._end(_LAST_WRITES_S)

    def end_if_stalled(self, how: str, *, until_ended: bool = False) -> None:
        """End the process as soon as the terminal has taken nothing for a while, as of a broken connection: leaving its
        screen would wait for it. ``until_ended``: look until the process ends, not only now."""
        if self._ends_process and os.name == "posix":
            threading.Thread(target=self._look_at_terminal, args=(how, until_ended), daemon=True).start()

    def _look_at_terminal(self, how: str, until_ended: bool) -> None:
        assert sys.__stderr__ is not None
        began_s = taken_s = time.monotonic()
        while time.monotonic() - taken_s < _STALLED_S:
            if select.select([], [sys.__stderr__], [], 0.0)[1]:
                taken_s = time.monotonic()
                if not until_ended and taken_s - began_s > _STALLED_S:
                    return
            time.sleep(_LOOK_S)
        running = self._app.jobs.running and not self._app.jobs.watched
        self._app.jobs.control.leave(how)
        self._app.jobs.wait(_LAST_WRITES_S)
        os._exit(STOPPED if running else self._app.code)

    def _end(self, after_s: float) -> None:
        self._app.post_message(LeaveAsked())
        if self._ends_process:
            threading.Thread(target=self._end_process, args=(after_s,), name="end", daemon=True).start()

    def _end_process(self, after_s: float) -> None:
        """End the process if Textual cannot: it waits for ever after a failed write to a closed terminal."""
        running = self._app.jobs.running and not self._app.jobs.watched
        self._app.wait_for_job()
        time.sleep(after_s)
        os._exit(STOPPED if running else self._app.code)
