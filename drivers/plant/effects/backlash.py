"""Play between drive and joint: the drive drags the joint along, which stays behind when the drive turns back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection


@dataclass(frozen=True, eq=False)
class Backlash(Effect):
    """The play operator. Its memory is where each joint is; a motion that does not turn back is one clipping."""

    half: Array

    def begin(self, q: Array) -> Array | None:
        return q

    def moved(self, memory: Array | None, q: Array) -> Array | None:
        assert memory is not None
        return np.clip(memory, q - self.half, q + self.half)

    def approached(self, q: Array, approach: Array) -> Array | None:
        return q - np.sign(approach) * self.half

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        return Deflection(joints=memory - situation.q)


def backlash(parameters: Parameters) -> Effect:
    """``play``: full width of the dead band of each joint [rad]."""
    parameters.only("play")
    return Backlash(parameters.numbers("play", least=0.0) / 2.0)
