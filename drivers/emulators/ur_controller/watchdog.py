"""The watchdog of a control program: it ends a program whose client stops writing a register."""

from __future__ import annotations

import math


class Watchdog:
    """Monitor of how often one input register is written; ``run_s`` [s] is the time that the controller has run."""

    def __init__(self) -> None:
        self.run_s = 0.0
        self._register = 0
        self._period_s = math.inf
        self._begun_s = 0.0
        self._written_s: dict[int, float] = {}

    def watch(self, least_hz: float, register: int) -> None:
        """Monitor from now on that ``register`` is written at least at ``least_hz``; 0 monitors nothing."""
        self._period_s = 1.0 / least_hz if least_hz > 0.0 else math.inf
        self._register, self._begun_s = register, self.run_s

    def written(self, register: int) -> None:
        """Note that a register was written now."""
        self._written_s[register] = self.run_s

    def complaint(self) -> str:
        """Return what is wrong, in words; empty while the register is written in time."""
        silent_s = self.run_s - max(self._written_s.get(self._register, -math.inf), self._begun_s)
        if silent_s <= self._period_s:
            return ""
        return f"watchdog: input_int_register_{self._register} not written for {silent_s:.3f} s"
