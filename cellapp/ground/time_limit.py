"""How long a job may last."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class TimeLimit:
    """``minutes`` from ``began_s`` by the clock ``now`` [s]; None: as long as it needs."""

    minutes: float | None = None
    began_s: float = 0.0
    now: Callable[[], float] = time.monotonic

    @classmethod
    def from_now(cls, minutes: float | None) -> TimeLimit:
        """That begins now."""
        return cls(minutes, time.monotonic())

    @property
    def left_s(self) -> float:
        """Time that is left [s]; infinite without a limit, negative beyond it."""
        return math.inf if self.minutes is None else 60.0 * self.minutes - (self.now() - self.began_s)

    def allowed(self, each_s: float, most: int) -> int:
        """How many further trials of a duration [s] fit, at most ``most``."""
        return int(max(min(self.left_s / max(each_s, 1e-6), most), 0.0))

    def words(self) -> str:
        """For a progress bar."""
        return "no time limit" if self.minutes is None else f"at most {self.minutes:g} min"
