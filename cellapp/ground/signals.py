"""Signals that reach their reaction at once, whatever the main thread is doing.

Python runs a signal handler between two instructions of the main thread: not while that is inside a long call of numpy
or SQLite. The operating system's own handler writes the signal's number into a socket at once; a thread waits there.
"""

from __future__ import annotations

import contextlib
import logging
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from types import FrameType

LOG = logging.getLogger(__name__)

Handler = Callable[[int, FrameType | None], object]

TERMINAL_CLOSED = "the terminal was closed"
"""What a run records as the cause of a halt where nobody attends the job any more."""
_END = b"\0"
"""No signal has the number 0."""
_LONGEST_REACTION_S = 2.0
"""A reaction that hangs must not keep the program from ending."""


def available(*names: str) -> tuple[int, ...]:
    """Return the numbers of those signals that this platform has: Windows lacks SIGHUP, SIGTSTP and SIGCONT."""
    return tuple(int(getattr(signal, name)) for name in names if hasattr(signal, name))


INTERRUPTS = available("SIGINT", "SIGTERM", "SIGBREAK")
"""What ends a program on request."""
HANGUP = available("SIGHUP")
"""The terminal was closed. It may come twice: once from the system, once from the shell."""


def ended_by(number: int) -> str:
    """Return what a run records as the cause of a halt by a signal that ends the program and is no key of a person."""
    name = signal.Signals(number).name
    return TERMINAL_CLOSED if name == "SIGHUP" else f"the program was asked to end ({name})"


@contextlib.contextmanager
def watch_signals(numbers: tuple[int, ...], react: Callable[[int], None], handler: Handler) -> Iterator[None]:
    """Call ``react(number)`` in a thread of its own for each signal in ``numbers``, in the order of their arrival.

    Python calls ``handler`` in the main thread as soon as that runs Python code. Call this in the main thread; earlier
    handlers return at the end.
    """
    receiver, sender = socket.socketpair()
    sender.setblocking(False)

    def watch() -> None:
        with receiver:
            while (byte := receiver.recv(1)) not in (_END, b""):
                if byte[0] in numbers:
                    try:
                        react(byte[0])
                    except Exception as error:  # noqa: BLE001 - the next signal must reach its reaction all the same
                        LOG.error("the reaction to signal %d failed: %s", byte[0], error)

    watcher = threading.Thread(target=watch, name="signals", daemon=True)
    earlier = {number: signal.signal(number, handler) for number in numbers}
    earlier_fd = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    watcher.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(earlier_fd)
        for number, before in earlier.items():
            signal.signal(number, before or signal.SIG_DFL)
        with sender:
            sender.setblocking(True)
            sender.sendall(_END)
        watcher.join(_LONGEST_REACTION_S)
