"""Time limits that count only the time in which this process ran.

A process that was suspended, or that found no free processor, has not waited: its time-outs must not blame a device.
Therefore waits are made in slices, and a slice that took much longer than asked counts as a short one.
"""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable
from typing import Self, TypeVar

T = TypeVar("T")

SLICE_S = 0.05
"""Longest wait at a stretch."""
MOST_S = 0.1
"""More than this does not count of a slice, nor of the time between two looks."""


class RunningTime:
    """A clock [s] that stands still while this process does not run; a loop looks at it many times a second."""

    def __init__(self) -> None:
        self._stood_s = 0.0
        self._looked_s = math.inf

    def at(self, now_s: float) -> float:
        """Return ``now_s`` (``time.monotonic``) without the times in which it stood still."""
        self._stood_s += max(now_s - self._looked_s - MOST_S, 0.0)
        self._looked_s = now_s
        return now_s - self._stood_s


class Patience:
    """A time limit. Whoever waits asks for ``slice_s`` again and again, and waits that long at a stretch."""

    def __init__(self, limit_s: float, whole: Self | None = None, look: Callable[[], None] | None = None) -> None:
        """Begin now. A limit that is part of a ``whole`` ends with that, too.

        ``look`` is called at every slice of a wait and may raise, to end it.
        """
        self._left_s = max(limit_s, 0.0)
        self._looked_s = time.monotonic()
        self._whole, self._look = whole, look

    @property
    def left_s(self) -> float:
        """What is left [s]; 0 when it is over."""
        if self._look is not None:
            self._look()
        now_s = time.monotonic()
        gone_s, self._looked_s = now_s - self._looked_s, now_s
        if gone_s > MOST_S and self._left_s > 0.0:  # what came meanwhile can be read in one more slice
            self._left_s = max(self._left_s - MOST_S, min(self._left_s, SLICE_S))
        else:
            self._left_s = max(self._left_s - gone_s, 0.0)
        return self._left_s if self._whole is None else min(self._left_s, self._whole.left_s)

    @property
    def over(self) -> bool:
        """Whether nothing is left."""
        return self.left_s <= 0.0

    @property
    def slice_s(self) -> float:
        """How long to wait now [s]; 0 when it is over."""
        return min(self.left_s, SLICE_S)

    def share(self, part: float) -> Self:
        """Return the limit of a part of what is left; what that waits is waited of the whole, too."""
        return type(self)(part * self.left_s, self)


def patient_get(waiting: queue.SimpleQueue[T], patience: Patience) -> T:
    """Return what comes first. Raises ``queue.Empty`` if nothing came in time."""
    while True:
        wait_s = patience.slice_s
        try:
            return waiting.get(timeout=wait_s) if wait_s > 0.0 else waiting.get_nowait()
        except queue.Empty:
            if wait_s <= 0.0:
                raise
