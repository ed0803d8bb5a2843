"""Heartbeat of the job in an open cell: others can see its age, whatever the job is doing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def asleep() -> float:
    """Return 0, the age [s] of data while the job waits on purpose: its own waiting is not silence."""
    return 0.0


class JobPulse:
    """Time of the last sign of life of the job's thread, which writes it; any thread can read it without waiting."""

    def __init__(self) -> None:
        self._beat_s = time.monotonic()
        self._waits_for: Callable[[], float] | None = None

    def beat(self) -> None:
        """Record a sign of life."""
        self._beat_s = time.monotonic()

    @contextmanager
    def waiting(self, age_s: Callable[[], float] = asleep) -> Iterator[None]:
        """While this context is open, count the job as alive as its device: ``age_s`` returns the data's age [s]."""
        self.beat()
        self._waits_for = age_s
        try:
            yield
        finally:
            self._waits_for = None
            self.beat()

    def age_s(self) -> float:
        """Return the age of the newest sign of life [s]."""
        waits_for, own_s = self._waits_for, time.monotonic() - self._beat_s
        return own_s if waits_for is None else min(own_s, waits_for())
