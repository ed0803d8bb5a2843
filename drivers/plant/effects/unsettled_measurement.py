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
    full lag applies. Sizes: an estimate, 5e-5 of a step of 1 rad.
    """

    fraction: Array
    time_constant: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        left = np.exp(-situation.since_rest_s[:, None] / self.time_constant)
        return Deflection(joints=-self.fraction * situation.last_step * left)


def unsettled_measurement(parameters: Parameters) -> Effect:
    """Build settling. Per joint: ``fraction`` of the last step missing at its end, ``time_constant`` [s]."""
    parameters.require("fraction", "time_constant")
    return UnsettledMeasurement(parameters.numbers("fraction"), parameters.numbers("time_constant", above=0.0))
