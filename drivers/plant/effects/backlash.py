"""Play between drive and joint: the drive drags the joint along, which stays behind when the drive turns back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection

_ELEMENTS = 16


@dataclass(frozen=True, eq=False)
class Backlash(Effect):
    """The play operator. Its memory is where each joint is; a motion that does not turn back is one clipping."""

    half: Array

    def begin(self, q: Array) -> Array | None:
        return q

    def moved(self, memory: Array | None, q: Array) -> Array | None:
        assert memory is not None
        return np.clip(memory, q - self.half, q + self.half)

    def remembered(self, situation: Situation) -> Array | None:
        q, step = situation.q, situation.last_step
        # from the middle of the play a short step does not reach its edge
        drag = np.where(step == 0.0, self.half, np.minimum(self.half, np.abs(step)))
        return q - np.sign(situation.approach) * drag

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        return Deflection(joints=memory - situation.q)


@dataclass(frozen=True, eq=False)
class SlippingTeeth(Effect):
    """Lost motion that grows with the length of the last step and saturates.

    Between drive and joint many elements sit in parallel, each of which sticks, is strained by the step, and slips
    beyond a strain of its own (Masing); these slip distances are spread exponentially about ``reach``. At rest they
    creep back to the middle, so that each step begins unstrained. The memory is the drive's angle and the joint's lag.
    """

    half: Array
    reach: Array

    def _lag(self, step: Array) -> Array:
        slips = -self.reach * np.log1p(-(np.arange(_ELEMENTS) + 0.5)[:, None, None] / _ELEMENTS)
        return self.half * np.minimum(np.abs(step) / slips, 1.0).mean(axis=0)

    def begin(self, q: Array) -> Array | None:
        return np.stack([q, np.zeros_like(q)])

    def moved(self, memory: Array | None, q: Array) -> Array | None:
        assert memory is not None
        step = q - memory[0]
        return np.stack([q, np.where(step == 0.0, memory[1], np.sign(step) * self._lag(step))])

    def remembered(self, situation: Situation) -> Array | None:
        step = situation.last_step
        lag = np.where(step == 0.0, self.half, self._lag(step))
        return np.stack([situation.q, np.sign(situation.approach) * lag])

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        return Deflection(joints=-memory[1])


def backlash(parameters: Parameters) -> Effect:
    """``play``: full width of the dead band of each joint [rad].

    With ``reach`` [rad] per joint, the lost motion saturates at half the play as the last step grows beyond ``reach``.
    """
    parameters.only("play", optional=("reach",))
    half = parameters.numbers("play", least=0.0) / 2.0
    if not parameters.together("reach"):
        return Backlash(half)
    return SlippingTeeth(half, parameters.numbers("reach", above=0.0))
