"""The one event type that every long job emits, and the token that cancels it. CLI, TUI and logs only listen."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """One step of a long job.

    Attributes
    ----------
    job : str
        What is being done, in a word or two; the same text for all events of one job.
    done, total : int
        Steps finished and steps in all; ``done == total`` is the job's last event.
    note : str
        What a person would like to know of this step; may be empty.
    """

    job: str
    done: int
    total: int
    note: str = ""


Listener = Callable[[Progress], None]


def ignore(event: Progress) -> None:
    """A listener for those who do not look."""


class Cancelled(Exception):
    """The job was cancelled by a person; what it had committed stays."""


class CancelToken:
    """Set from any thread; jobs ask it between steps."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def cancel(self) -> None:
        """Ask the job to stop at its next step."""
        self._event.set()

    @property
    def cancelled(self) -> bool:
        """Whether somebody asked to stop."""
        return self._event.is_set()

    def wait(self, timeout_s: float) -> bool:
        """Rest for at most ``timeout_s``, less if somebody asks to stop; whether somebody did."""
        return self._event.wait(timeout_s)

    def check(self) -> None:
        """Raise ``Cancelled`` if somebody asked to stop."""
        if self.cancelled:
            raise Cancelled("stopped on request")
