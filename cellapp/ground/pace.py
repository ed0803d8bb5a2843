"""How fast a job goes on: the estimated time to its end, and lines that tell it where there is no terminal."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from cellapp.ground.progress import Listener, Progress, StateChange

_RECENT_STEPS = 20
"""Steps of which the rate is taken: enough to smooth single long ones, few enough to follow a change of pace."""


def with_eta(listener: Listener, clock: Callable[[], float] = time.monotonic) -> Listener:
    """Return a listener that passes events on, one at a time, and estimates ``eta_s`` where an event has none.

    The estimate is the rate of the job's own recent steps; steps that were done before the first event do not count.
    """
    paces: dict[str, _Pace] = {}
    lock = threading.Lock()

    def listen(event: Progress) -> None:
        with lock:
            eta_s = paces.setdefault(event.job, _Pace()).eta_s(event, clock())
            listener(event if event.eta_s is not None else replace(event, eta_s=eta_s))

    return listen


_SILENCE_S = 60.0
"""How long a job without a terminal is silent at most, while it has something to tell."""


def in_lines(say: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> Listener:
    """Return a listener that says in a line how far a long job is, at most once a minute; nothing of a shorter one."""
    said_s = clock()
    lock = threading.Lock()

    def listen(event: Progress) -> None:
        nonlocal said_s
        with lock:
            now_s = clock()
            if now_s - said_s < _SILENCE_S:
                return
            said_s = now_s
        words = (f"{event.done} of {event.total}", event.note, eta_words(event.eta_s))
        say(f"{event.job}: {', '.join(filter(None, words))}")

    return listen


@dataclass
class _Pace:
    """When the recent steps of a job were done: (steps done, time [s])."""

    steps: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=_RECENT_STEPS + 1))

    def eta_s(self, event: Progress, now_s: float) -> float | None:
        """Return the estimated time to the job's end [s]; None before a step was done under our eyes."""
        if event.done >= event.total:
            self.steps.clear()
            return 0.0
        again = bool(self.steps) and event.done < self.steps[-1][0]
        if again or isinstance(event.detail, StateChange):  # a pause is no part of the pace
            self.steps.clear()
        if not self.steps or event.done > self.steps[-1][0]:
            self.steps.append((event.done, now_s))
        (first, began_s), (last, latest_s) = self.steps[0], self.steps[-1]
        if last == first:
            return None
        step_s = (latest_s - began_s) / (last - first)
        if now_s - latest_s > step_s:  # the present step is longer than those before
            step_s = (now_s - began_s) / (last - first + 1)
        return max((event.total - last) * step_s - (now_s - latest_s), 0.0)


def eta_words(eta_s: float | None) -> str:
    """Return an estimated time as "3 min left"; empty while it is not known."""
    if eta_s is None:
        return ""
    if eta_s < 60.0:
        return f"{eta_s:.0f} s left"
    minutes = round(eta_s / 60.0)
    return f"{minutes} min left" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min left"
