"""Temperatures: air that drifts slowly, joints that warm up as they move."""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array

_AIR_AMPLITUDE_K = 0.5
_AIR_PERIODS_S = np.array([2.6, 5.3, 11.0]) * 3600.0
_AIR_SHARES = np.array([0.2, 0.3, 0.5])

JOINT_TIME_CONSTANT_S = 2400.0
JOINT_RISE_K = 20.0
"""Rise above the air that a joint tends to when it turns at 1 rad/s without rest, over one that stands."""


class Air:
    """Air temperature: the configured value and three slow waves with seeded phases, 0.5 K together at most."""

    def __init__(self, mean_c: float, rng: np.random.Generator) -> None:
        self._mean_c = mean_c
        self._phases = rng.uniform(0.0, 2.0 * np.pi, len(_AIR_PERIODS_S))

    def temperature_c(self, time_s: Array) -> Array:
        """Temperature (n,) at times (n,) [degC]."""
        waves = np.sin(2.0 * np.pi * time_s[:, None] / _AIR_PERIODS_S + self._phases)
        return self._mean_c + _AIR_AMPLITUDE_K * (waves * _AIR_SHARES).sum(axis=1)


def joint_rise(rise: Array, speed: Array, duration_s: float, holding_k: float = 0.0) -> Array:
    """Rise above the air (N,) [K] after turning at the mean ``speed`` (N,) [rad/s] for a time: first order.

    ``holding_k`` is what a joint that stands tends to: its electronics, its brake, the current that holds it.
    """
    end = holding_k + JOINT_RISE_K * speed
    return end + (rise - end) * np.exp(-duration_s / JOINT_TIME_CONSTANT_S)
