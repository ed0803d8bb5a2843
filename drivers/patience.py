"""Time limits that count only the time in which this process was scheduled.

A process that was suspended, or that got no processor, has not waited: its timeouts must not blame a device. Therefore
waits are divided into slices, and a slice that took much longer than requested counts as a short one.
"""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable
from typing import Self, TypeVar

T = TypeVar("T")

SLICE_S = 0.05
"""Longest single wait."""
MOST_S = 0.1
"""Largest time that counts for one slice, or between two looks."""


class RunningTime:
    """A clock [s] that does not advance while this process is not scheduled; call ``at`` many times a second."""

    def __init__(self) -> None:
        self._stood_s = 0.0
        self._looked_s = math.inf

    def at(self, now_s: float) -> float:
        """Return ``now_s`` (``time.monotonic``) without the times in which this process was not scheduled."""
        self._stood_s += max(now_s - self._looked_s - MOST_S, 0.0)
        self._looked_s = now_s
        return now_s - self._stood_s


class Patience:
    """A time limit. Divide a wait into slices: wait ``slice_s`` again and again until it is 0."""

    def __init__(self, limit_s: float, whole: Self | None = None, look: Callable[[], None] | None = None) -> None:
        """Start the limit now. A limit that is part of a ``whole`` also ends with it.

        ``look`` is called at every slice of a wait and may raise to end it.
        """
        self._remaining_s = max(limit_s, 0.0)
        self._looked_s = time.monotonic()
        self._whole, self._look = whole, look

    @property
    def remaining_s(self) -> float:
        """Remaining time [s]; 0 when the limit is over."""
        if self._look is not None:
            self._look()
        now_s = time.monotonic()
        gone_s, self._looked_s = now_s - self._looked_s, now_s
        if gone_s > MOST_S and self._remaining_s > 0.0:  # one more slice, to read what came meanwhile
            self._remaining_s = max(self._remaining_s - MOST_S, min(self._remaining_s, SLICE_S))
        else:
            self._remaining_s = max(self._remaining_s - gone_s, 0.0)
        return self._remaining_s if self._whole is None else min(self._remaining_s, self._whole.remaining_s)

    @property
    def over(self) -> bool:
        """Whether no time remains."""
        return self.remaining_s <= 0.0

    @property
    def slice_s(self) -> float:
        """How long to wait now [s]; 0 when the limit is over."""
        return min(self.remaining_s, SLICE_S)

    def share(self, part: float) -> Self:
        """Return a limit of a part of the remaining time; its waits also count for this limit."""
        return type(self)(part * self.remaining_s, self)


def patient_get(waiting: queue.SimpleQueue[T], patience: Patience) -> T:
    """Return the first item of a queue. Raises ``queue.Empty`` if none arrives in time."""
    while True:
        wait_s = patience.slice_s
        try:
            return waiting.get(timeout=wait_s) if wait_s > 0.0 else waiting.get_nowait()
        except queue.Empty:
            if wait_s <= 0.0:
                raise
