"""Timestamped record of what a controller received and did: stops in any way, motions begun and ended."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Literal

EventKind = Literal["stop", "begun", "ended"]
_MOST = 5000


@dataclass(frozen=True)
class Event:
    """One event at ``at_s`` (``time.monotonic`` of this process, comparable on one computer) [s].

    ``how`` is the way in which a stop arrived, or the cause of a motion: "move", "resume" or "stream".
    """

    at_s: float
    kind: EventKind
    how: str


class Journal:
    """The last events of one controller, oldest first."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._events: deque[Event] = deque(maxlen=_MOST)

    def note(self, kind: EventKind, how: str) -> None:
        """Record an event at the current time."""
        self._events.append(Event(self._clock(), kind, how))

    def since(self, at_s: float) -> list[dict[str, Any]]:
        """Return the events from ``at_s`` on, for the control channel."""
        return [asdict(event) for event in self._events if event.at_s >= at_s]
