"""Temperatures: slow drift of the air, joints that warm up by motion."""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array

_AIR_AMPLITUDE_K = 0.5
_AIR_PERIODS_S = np.array([2.6, 5.3, 11.0]) * 3600.0
_AIR_SHARES = np.array([0.2, 0.3, 0.5])

JOINT_TIME_CONSTANT_S = 2400.0
"""Time constant of a joint's warm-up, which takes about two hours, three time constants (an estimate)."""
JOINT_RISE_K = 20.0
"""Steady-state temperature difference of a joint that rotates at 1 rad/s without pause and one at rest [K]."""


class Air:
    """Air temperature: the configured mean plus three slow sine waves with seeded phases, at most 0.5 K."""

    def __init__(self, mean_c: float, rng: np.random.Generator) -> None:
        self._mean_c = mean_c
        self._phases = rng.uniform(0.0, 2.0 * np.pi, len(_AIR_PERIODS_S))

    def temperature_c(self, time_s: Array) -> Array:
        """Return the temperature (n,) [degC] at times (n,) [s]."""
        waves = np.sin(2.0 * np.pi * time_s[:, None] / _AIR_PERIODS_S + self._phases)
        temperature: Array = self._mean_c + _AIR_AMPLITUDE_K * (waves * _AIR_SHARES).sum(axis=1)
        return temperature


def joint_rise(rise: Array, speed: Array, duration_s: float, holding_k: float = 0.0) -> Array:
    """Return the rise above the air (N,) [K] after rotating at the mean ``speed`` (N,) [rad/s]: a first-order lag.

    ``holding_k`` is the steady-state rise of a joint at rest, from electronics, brake and holding current.
    """
    end = holding_k + JOINT_RISE_K * speed
    after: Array = end + (rise - end) * np.exp(-duration_s / JOINT_TIME_CONSTANT_S)
    return after
