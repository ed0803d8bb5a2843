"""Readings taken before the joint has settled: a part of the last step decays exponentially."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import NOT_NEGATIVE, NUMBERS, POSITIVE, POSITIVES, PlantEffect, Read, Situation, by_law, made
from drivers.plant.mechanism import Deflection


@dataclass(frozen=True, eq=False)
class TrueSettling(PlantEffect):
    """A spring and a damper in parallel behind the drive (Kelvin-Voigt).

    At the end of a step the joint lags by ``fraction`` of it; the lag decays while the arm rests. During motion the
    full lag applies. Size: 5e-5 of a step of 1 rad (an estimate).
    """

    fraction: Array
    time_constant: Array

    def remaining(self, rest_s: Array) -> Array:
        """Return the share of the lag that is left (n, N) after times at rest (n, 1) [s]."""
        return np.asarray(np.exp(-rest_s / self.time_constant))

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        return Deflection(joints=-self.fraction * situation.last_step * self.remaining(situation.since_rest_s[:, None]))


@dataclass(frozen=True, eq=False)
class TwoRateSettling(TrueSettling):
    """Two Kelvin-Voigt elements in series, a quick and a slow one; ``slow_share`` of the lag decays slowly."""

    slow_time_constant: Array
    slow_share: float

    def remaining(self, rest_s: Array) -> Array:
        slow = self.slow_share * np.exp(-rest_s / self.slow_time_constant)
        return np.asarray((1.0 - self.slow_share) * super().remaining(rest_s) + slow)


@dataclass(frozen=True, eq=False)
class PowerSettling(TrueSettling):
    """Creep of lubricant or polymer: the lag decays with a power of time, ``(1 + t / time_constant)^-power``."""

    power: float

    def remaining(self, rest_s: Array) -> Array:
        return np.asarray((1.0 + rest_s / self.time_constant) ** -self.power)


_PLAIN: Mapping[str, Read] = {"fraction": NUMBERS, "time_constant": POSITIVES}

unsettled_measurement = by_law(
    exponential=made(TrueSettling, **_PLAIN),
    two_rates=made(TwoRateSettling, **_PLAIN, slow_time_constant=POSITIVES, slow_share=NOT_NEGATIVE),
    power=made(PowerSettling, **_PLAIN, power=POSITIVE),
)
"""Per joint: ``fraction`` of the last step missing at its end, ``time_constant`` [s].

Other laws: ``law`` two_rates with ``slow_time_constant`` [s] per joint and ``slow_share`` (0 to 1); power with
``power``.
"""
