"""The clock of a cell: real time, or the time of the simulated cell."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from drivers.plant import Plant

Sleep = Callable[[float], object]
"""Function that sleeps for at most the given time [s] and returns early when the job is cancelled."""


class Clock(Protocol):
    """One clock for a whole cell: arms, tracker and the jobs that use them."""

    def now_s(self) -> float:
        """Return the time since an arbitrary origin [s]; never decreases."""

    def wait(self, duration_s: float, sleep: Sleep) -> None:
        """Wait until ``duration_s`` [s] have passed. ``sleep`` is a wait in real time that the caller can cancel."""


class RealClock:
    """The monotonic clock of this computer."""

    def now_s(self) -> float:
        """Return the monotonic time [s]."""
        return time.monotonic()

    def wait(self, duration_s: float, sleep: Sleep) -> None:
        """Sleep; a cancelled job wakes early."""
        sleep(duration_s)


def slept_s() -> float:
    """Return how long this computer has been suspended since it started [s]; 0 if the system does not report it."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return 0.0 if clock is None else time.clock_gettime(clock) - time.clock_gettime(time.CLOCK_MONOTONIC)


class SimulatedClock:
    """The clock of a ``plant``: a wait advances the simulation and takes no real time."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant

    def now_s(self) -> float:
        """Return the time since the simulation began [s]."""
        return self.plant.clock_s

    def wait(self, duration_s: float, sleep: Sleep) -> None:
        """Advance the simulation."""
        self.plant.advance(duration_s)
