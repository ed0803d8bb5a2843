"""The stop latch of a UR arm: from a brake until the next ``connect`` all motions are refused."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager


class StopLatch:
    """Counter of brakes and of stops under way. Any thread may call any method.

    Attributes
    ----------
    brakes : int
        Number of brakes so far.
    stops : int
        Number of stops being commanded or waited for. They would also stop a program that is started meanwhile.
    """

    def __init__(self) -> None:
        self.brakes = 0
        self.stops = 0
        self._released = 0
        self._changed = threading.Condition()

    @property
    def in_force(self) -> bool:
        """Whether a brake has not been released."""
        return self.brakes > self._released

    def refuse(self) -> None:
        """Count a brake; it may be commanded later."""
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
