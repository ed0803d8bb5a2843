"""Readings taken before the joint has settled: a part of the last step decays exponentially."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection


@dataclass(frozen=True, eq=False)
class UnsettledMeasurement(Effect):
    """A spring and a damper in parallel behind the drive (Kelvin-Voigt).

    At the end of a step the joint lags by ``fraction`` of it; the lag decays while the arm rests. During motion the
    full lag applies. Size: 5e-5 of a step of 1 rad (an estimate).
    """

    fraction: Array
    time_constant: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        left = np.exp(-situation.since_rest_s[:, None] / self.time_constant)
        return Deflection(joints=-self.fraction * situation.last_step * left)


@dataclass(frozen=True, eq=False)
class TwoRateSettling(Effect):
    """Two Kelvin-Voigt elements in series, a quick and a slow one; ``slow_share`` of the lag decays slowly."""

    fraction: Array
    time_constant: Array
    slow_time_constant: Array
    slow_share: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        rest = situation.since_rest_s[:, None]
        quick, slow = (np.exp(-rest / time) for time in (self.time_constant, self.slow_time_constant))
        left = (1.0 - self.slow_share) * quick + self.slow_share * slow
        return Deflection(joints=-self.fraction * situation.last_step * left)


@dataclass(frozen=True, eq=False)
class PowerSettling(Effect):
    """Creep of lubricant or polymer: the lag decays with a power of time, ``(1 + t / time_constant)^-power``."""

    fraction: Array
    time_constant: Array
    power: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        left = (1.0 + situation.since_rest_s[:, None] / self.time_constant) ** -self.power
        return Deflection(joints=-self.fraction * situation.last_step * left)


def unsettled_measurement(parameters: Parameters) -> Effect:
    """Build settling. Per joint: ``fraction`` of the last step missing at its end, ``time_constant`` [s].

    Other laws: ``law`` two_rates with ``slow_time_constant`` [s] per joint and ``slow_share`` (0 to 1); power with
    ``power``.
    """
    law, parameters = parameters.by_law("exponential", "two_rates", "power")
    if law == "two_rates":
        parameters.require("fraction", "time_constant", "slow_time_constant", "slow_share")
        return TwoRateSettling(
            parameters.numbers("fraction"),
            parameters.numbers("time_constant", above=0.0),
            parameters.numbers("slow_time_constant", above=0.0),
            parameters.number("slow_share", least=0.0),
        )
    if law == "power":
        parameters.require("fraction", "time_constant", "power")
        return PowerSettling(
            parameters.numbers("fraction"),
            parameters.numbers("time_constant", above=0.0),
            parameters.number("power", above=0.0),
        )
    parameters.require("fraction", "time_constant")
    return UnsettledMeasurement(parameters.numbers("fraction"), parameters.numbers("time_constant", above=0.0))
