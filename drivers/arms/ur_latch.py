"""The latch of a UR arm: motions are refused from a brake until the next connection."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager


class StopLatch:
    """Counts brakes, and stops that are under way. Any thread may call any method.

    Attributes
    ----------
    brakes : int
        Number of brakes so far.
    stops : int
        Stops that are being commanded or waited for: a program that is started meanwhile would be stopped by them.
    """

    def __init__(self) -> None:
        self.brakes = 0
        self.stops = 0
        self._released = 0
        self._changed = threading.Condition()

    @property
    def in_force(self) -> bool:
        """Whether there was a brake that has not been released."""
        return self.brakes > self._released

    def refuse(self) -> None:
        """Count a brake, which may be commanded later."""
        with self._changed:
            self.brakes += 1
            self._changed.notify_all()

    @contextmanager
    def stopping(self) -> Iterator[None]:
        """Count a stop that is under way."""
        with self._changed:
            self.stops += 1
        try:
            yield
        finally:
            with self._changed:
                self.stops -= 1
                self._changed.notify_all()

    def wait_for_stops(self, brakes: int, timeout_s: float) -> None:
        """Wait until no stop is under way, or until there are more than ``brakes`` brakes."""
        with self._changed:
            self._changed.wait_for(lambda: not self.stops or self.brakes != brakes, timeout_s)

    def release(self, brakes: int) -> None:
        """Release all brakes up to number ``brakes``."""
        with self._changed:
            self._released = max(self._released, brakes)
