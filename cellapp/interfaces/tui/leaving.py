"""Exit on request of the system: the terminal was closed, or the program must end. Ctrl-Z pauses instead."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator

from cellapp.ground.signals import HANGUP, INTERRUPTS, TERMINAL_CLOSED, available, ended_by, watch_signals
from cellapp.interfaces.tui.endings import STOPPED, forget_terminal
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.messages import LeaveAsked

LEFT = "a person left the application"
ENDED = "the terminal application ended"
"""Cause of the halt that a run records."""
_PAUSING = available("SIGTSTP")
_LAST_WORDS_S = 5.0
"""Time limit for leaving the screen after the end of the job; usually about 0.1 s."""
_LAST_WRITES_S = 0.5
"""The same if the terminal is gone: nobody reads it, and the next start waits for the files that this one holds."""


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
