"""Backlash between drive and joint: after a reversal the joint follows only when the play is used up.

Besides sharp play there are three laws with a gradual transition.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection

_ELEMENTS = 16
_REFERENCE_C = 20.0
"""Temperature for which a temperature-dependent play is stated [degC]."""


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
    strain of their own. Their slip distances are distributed exponentially with mean ``reach``. At rest the elements
    relax, so each step begins unstrained. The memory is the drive's angle and the joint's lag.
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


@dataclass(frozen=True, eq=False)
class WarmPlay(Effect):
    """Lost motion ``half (1 - exp(-|step| / reach))`` against the last step, in a gear whose play grows as it warms.

    ``half`` is stated for 20 degC; its relative change is ``per_kelvin`` times the rise of the joint's temperature. The
    memory is the drive's angle and the used share of the play.
    """

    half: Array
    reach: Array
    per_kelvin: float

    def _share(self, step: Array) -> Array:
        share: Array = -np.expm1(-np.abs(step) / self.reach)
        return share

    def initial_memory(self, q: Array) -> Array | None:
        return np.stack([q, np.zeros_like(q)])

    def memory_after_motion(self, memory: Array | None, q: Array) -> Array | None:
        assert memory is not None
        step = q - memory[0]
        return np.stack([q, np.where(step == 0.0, memory[1], np.sign(step) * self._share(step))])

    def assumed_memory(self, situation: Situation) -> Array | None:
        step = situation.last_step
        share = np.where(step == 0.0, 1.0, self._share(step))
        return np.stack([situation.q, np.sign(situation.approach) * share])

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        warm = 1.0 + self.per_kelvin * (situation.joints_c - _REFERENCE_C)
        return Deflection(joints=-self.half * warm * memory[1])


@dataclass(frozen=True, eq=False)
class ManyPlays(Effect):
    """Preisach-like hysteresis: many plays in parallel, of widths up to ``reach``, each with a memory of its own.

    Prandtl-Ishlinskii model with equal weights: the lost motion is the mean over the elements, each between -half and
    +half. After a short reversal it depends on the motions before the last one. The memory is the elements' positions.
    """

    half: Array
    reach: Array

    def _widths(self) -> Array:
        widths: Array = self.reach * ((np.arange(_ELEMENTS) + 0.5) / _ELEMENTS)[:, None, None]
        return widths

    def initial_memory(self, q: Array) -> Array | None:
        return np.repeat(q[None], _ELEMENTS, axis=0)

    def memory_after_motion(self, memory: Array | None, q: Array) -> Array | None:
        assert memory is not None
        elements: Array = np.clip(memory, q - self._widths(), q + self._widths())
        return elements

    def assumed_memory(self, situation: Situation) -> Array | None:
        q, step, widths = situation.q, situation.last_step, self._widths()
        drag = np.where(step == 0.0, widths, np.minimum(widths, np.abs(step)))
        elements: Array = q - np.sign(situation.approach) * drag
        order = np.argsort(situation.time_s, kind="stable")
        if situation.time_s[order[0]] == situation.time_s[order[-1]]:
            return elements
        for before, now in pairwise(order):  # one history; the last motion may begin elsewhere than at the last stop
            moved = elements[:, before]
            for reached in (q[now] - step[now], q[now]):
                moved = np.clip(moved, reached - widths[:, 0], reached + widths[:, 0])
            elements[:, now] = moved
        return elements

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        return Deflection(joints=self.half * ((memory - situation.q) / self._widths()).mean(axis=0))


def backlash(parameters: Parameters) -> Effect:
    """Build backlash. ``play``: full width of the dead band of each joint [rad].

    With ``reach`` [rad] per joint, the lost motion saturates at half the play as the last step grows beyond ``reach``.
    Other laws, with ``reach``: ``law`` warm, whose play at 20 degC changes by ``per_kelvin`` [1/K]; many_plays.
    """
    law, parameters = parameters.by_law("play", "warm", "many_plays")
    if law == "warm":
        parameters.require("play", "reach", "per_kelvin")
        half, reach = parameters.numbers("play", least=0.0) / 2.0, parameters.numbers("reach", above=0.0)
        return WarmPlay(half, reach, parameters.number("per_kelvin"))
    if law == "many_plays":
        parameters.require("play", "reach")
        return ManyPlays(parameters.numbers("play", least=0.0) / 2.0, parameters.numbers("reach", above=0.0))
    parameters.require("play", optional=("reach",))
    half = parameters.numbers("play", least=0.0) / 2.0
    if not parameters.all_or_none("reach"):
        return Backlash(half)
    return SlippingElements(half, parameters.numbers("reach", above=0.0))
