"""Readings taken before the joint has come to rest: the last of a step is still creeping in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection


@dataclass(frozen=True, eq=False)
class UnsettledMeasurement(Effect):
    """A spring and a damper in parallel behind the drive: what a step leaves over dies away while the arm rests.

    At the end of the step the joint is behind by ``fraction`` of it; while moving, and at rest for no time yet, all
    of that is left. Sizes: an estimate, 5e-5 of a step of 1 rad.
    """

    fraction: Array
    time_constant: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        left = np.exp(-situation.since_rest_s[:, None] / self.time_constant)
        return Deflection(joints=-self.fraction * situation.last_step * left)


def unsettled_measurement(parameters: Parameters) -> Effect:
    """Per joint: ``fraction`` of the last step that is left as the arm comes to rest, ``time_constant`` [s]."""
    parameters.only("fraction", "time_constant")
    return UnsettledMeasurement(parameters.numbers("fraction"), parameters.numbers("time_constant", above=0.0))
