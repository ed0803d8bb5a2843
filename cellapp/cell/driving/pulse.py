"""The sign of life of the job in an open cell: people see how old it is, whatever the job is doing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def asleep() -> float:
    """Age of the data [s] while the job waits on purpose: a wait of its own is no silence."""
    return 0.0


class JobPulse:
    """When the job's thread last gave a sign of life. It writes; any thread may read, without waiting."""

    def __init__(self) -> None:
        self._beat_s = time.monotonic()
        self._waits_for: Callable[[], float] | None = None

    def beat(self) -> None:
        """Give a sign of life."""
        self._beat_s = time.monotonic()

    @contextmanager
    def waiting(self, age_s: Callable[[], float] = asleep) -> Iterator[None]:
        """While this context is open the job waits for a device and is as alive as its data, of age ``age_s`` [s]."""
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
