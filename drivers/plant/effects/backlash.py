"""Backlash between drive and joint: after a reversal the joint follows only when the play is used up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection

_ELEMENTS = 16


@dataclass(frozen=True, eq=False)
class Backlash(Effect):
    """Play operator. The memory is the position of each joint; a motion without reversal is one clipping."""

    half: Array

    def initial_memory(self, q: Array) -> Array | None:
        return q

    def memory_after_motion(self, memory: Array | None, q: Array) -> Array | None:
        assert memory is not None
        joint: Array = np.clip(memory, q - self.half, q + self.half)
        return joint

    def assumed_memory(self, situation: Situation) -> Array | None:
        q, step = situation.q, situation.last_step
        # a short step from the middle of the play does not reach its edge
        drag = np.where(step == 0.0, self.half, np.minimum(self.half, np.abs(step)))
        joint: Array = q - np.sign(situation.approach) * drag
        return joint

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        return Deflection(joints=memory - situation.q)


@dataclass(frozen=True, eq=False)
class SlippingElements(Effect):
    """Lost motion that grows with the length of the last step and saturates.

    Masing model: many parallel elements between drive and joint stick, are strained by the step, and slip beyond a
    strain of their own; the slip distances are distributed exponentially with mean ``reach``. At rest the elements
    relax, so that each step begins unstrained. The memory is the drive's angle and the joint's lag.
    """

    half: Array
    reach: Array

    def _lag(self, step: Array) -> Array:
        slips = -self.reach * np.log1p(-(np.arange(_ELEMENTS) + 0.5)[:, None, None] / _ELEMENTS)
        lag: Array = self.half * np.minimum(np.abs(step) / slips, 1.0).mean(axis=0)
        return lag

    def initial_memory(self, q: Array) -> Array | None:
        return np.stack([q, np.zeros_like(q)])

    def memory_after_motion(self, memory: Array | None, q: Array) -> Array | None:
        assert memory is not None
        step = q - memory[0]
        return np.stack([q, np.where(step == 0.0, memory[1], np.sign(step) * self._lag(step))])

    def assumed_memory(self, situation: Situation) -> Array | None:
        step = situation.last_step
        lag = np.where(step == 0.0, self.half, self._lag(step))
        return np.stack([situation.q, np.sign(situation.approach) * lag])

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        return Deflection(joints=-memory[1])


def backlash(parameters: Parameters) -> Effect:
    """Build backlash. ``play``: full width of the dead band of each joint [rad].

    With ``reach`` [rad] per joint, the lost motion saturates at half the play as the last step grows beyond ``reach``.
    """
    parameters.require("play", optional=("reach",))
    half = parameters.numbers("play", least=0.0) / 2.0
    if not parameters.all_or_none("reach"):
        return Backlash(half)
    return SlippingElements(half, parameters.numbers("reach", above=0.0))
