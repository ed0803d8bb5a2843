"""Watching the tracker while the arms move: a tracker that died stops the cell, not only the next measurement."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from drivers.trackers.protocol import Tracker, TrackerError

Died = Callable[[str], None]
"""Takes the reason, in a sentence, from any thread."""
Watch = Callable[[Tracker, Died], AbstractContextManager[None]]
"""Watches a tracker while its context is open."""

_EVERY_S = 0.25
"""Between two questions: a small load for a serial line."""
_SILENT_S = 2.0
"""A tracker that has not answered for this long counts as dead; over a network it answers within milliseconds."""
_LAST_ANSWER_S = 5.0
"""Longest wait for the last answer."""


@contextmanager
def watched(tracker: Tracker, died: Died, silent_s: float = _SILENT_S) -> Iterator[None]:
    """Ask the tracker for its state again and again, in a thread; the caller must not use it meanwhile.

    At the end, the last answer is awaited, so that the caller's next call is the only one. A call that hangs longer
    was reported, and the tracker is reconnected before it is used again.
    """
    over, answered = threading.Event(), threading.Event()

    def ask() -> None:
        while not over.is_set():
            try:
                tracker.unmet()  # what it lacks for measuring does not matter while the arms move
            except TrackerError as error:
                died(str(error))
                break
            answered.set()
            over.wait(_EVERY_S)
        answered.set()

    def listen() -> None:
        while not over.is_set():
            if not answered.wait(silent_s):
                died(f"tracker: no answer for {silent_s:g} s while the arms moved")
                return
            answered.clear()
            over.wait(_EVERY_S)

    asking = threading.Thread(target=ask, name="tracker watch", daemon=True)
    threads = [asking, threading.Thread(target=listen, name="tracker watch limit", daemon=True)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        over.set()
        asking.join(_LAST_ANSWER_S)


def unwatched(tracker: Tracker, died: Died) -> nullcontext[None]:
    """Do not watch: in a simulated cell all calls come from one thread."""
    return nullcontext()
