"""Exit on request of the system: the terminal was closed, or the program must end. Ctrl-Z pauses instead."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator

from cellapp.ground.signals import HANGUP, INTERRUPTS, TERMINAL_CLOSED, available, ended_by, watch_signals
from cellapp.interfaces.tui.jobs import JobRunner

STOPPED = 4
"""Exit code of a job that was stopped and can be resumed."""
LEFT = "a person left the application"
ENDED = "the terminal application ended"
"""Cause of the halt that a run records."""
_PAUSING = available("SIGTSTP")
_LAST_WORDS_S = 5.0
"""Time limit for leaving the screen after the end of the job; usually about 0.1 s."""
_LAST_WRITES_S = 0.5
"""The same if the terminal is gone: nobody reads it, and the next start waits for the files that this one holds."""


_STALLED_S, _LOOK_S = 1.5, 0.05


def forget_terminal() -> None:
    """Redirect output to the null device: the terminal was closed, and writing to it would fail."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    os.close(nowhere)


class Leaving:
    """Stops the job, then ends the application.

    Parameters
    ----------
    jobs : JobRunner
    leave : callable
        Leaves the screen; called from any thread.
    patience_s : float
        How long leaving waits for a job to stop before the program ends without it.
    ends_process : bool
        Whether a signal that ends the program ends the process even if the screen cannot be left.
    """

    def __init__(self, jobs: JobRunner, leave: Callable[[], object], patience_s: float, *, ends_process: bool) -> None:
        self._jobs, self._leave, self.patience_s, self._ends_process = jobs, leave, patience_s, ends_process
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

    def wait_for_job(self) -> None:
        """Wait, with a time limit, until an abandoned job has brought its arms to rest."""
        if self._jobs.running:
            self._jobs.wait(self.patience_s)

    def _react(self, number: int) -> None:
        """React to a signal, in the thread that watches the signals."""
        control = self._jobs.control
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
        self._jobs.control.leave(TERMINAL_CLOSED)
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
        running = self._jobs.running and not self._jobs.watched
        self._jobs.control.leave(how)
        self._jobs.wait(_LAST_WRITES_S)
        os._exit(STOPPED if running else self._jobs.code)

    def _end(self, after_s: float) -> None:
        self._leave()
        if self._ends_process:
            threading.Thread(target=self._end_process, args=(after_s,), name="end", daemon=True).start()

    def _end_process(self, after_s: float) -> None:
        """End the process if Textual cannot: it waits for ever after a failed write to a closed terminal."""
        running = self._jobs.running and not self._jobs.watched
        self.wait_for_job()
        time.sleep(after_s)
        os._exit(STOPPED if running else self._jobs.code)
