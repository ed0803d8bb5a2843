"""Backlash between drive and joint: after a reversal the joint follows only when the play is used up.

Besides sharp play there are three laws with a gradual transition.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import NUMBER, POSITIVES, Parameters, PlantEffect, Situation, by_law, made
from drivers.plant.mechanism import Deflection

_ELEMENTS = 16
_REFERENCE_C = 20.0
"""Temperature for which a temperature-dependent play is stated [degC]."""


@dataclass(frozen=True, eq=False)
class TrueBacklash(PlantEffect):
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
class GradualPlay(PlantEffect):
    """Lost motion against the last step that grows with its length and saturates at ``half``.

    The memory is the drive's angle and the used share of the play, with the sign of the step.
    """

    half: Array
    reach: Array

    @abstractmethod
    def share(self, step: Array) -> Array:
        """Return the share of the play that a step uses."""

    def initial_memory(self, q: Array) -> Array | None:
        return np.stack([q, np.zeros_like(q)])

    def memory_after_motion(self, memory: Array | None, q: Array) -> Array | None:
        assert memory is not None
        step = q - memory[0]
        return np.stack([q, np.where(step == 0.0, memory[1], np.sign(step) * self.share(step))])

    def assumed_memory(self, situation: Situation) -> Array | None:
        step = situation.last_step
        share = np.where(step == 0.0, 1.0, self.share(step))
        return np.stack([situation.q, np.sign(situation.approach) * share])

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        return Deflection(joints=-self.half * memory[1])


class SlippingElements(GradualPlay):
    """Lost motion of many parallel elements between drive and joint.

    Masing model: they stick, are strained by the step, and slip beyond a strain of their own. Their slip distances are
    distributed exponentially with mean ``reach``. At rest they relax, so each step begins unstrained.
    """

    def share(self, step: Array) -> Array:
        slips = -self.reach * np.log1p(-(np.arange(_ELEMENTS) + 0.5)[:, None, None] / _ELEMENTS)
        return np.asarray(np.minimum(np.abs(step) / slips, 1.0).mean(axis=0))


@dataclass(frozen=True, eq=False)
class WarmPlay(GradualPlay):
    """Lost motion ``half (1 - exp(-|step| / reach))`` against the last step, in a gear whose play grows as it warms.

    ``half`` is stated for 20 degC; its relative change is ``per_kelvin`` times the rise of the joint's temperature.
    """

    per_kelvin: float

    def share(self, step: Array) -> Array:
        return np.asarray(-np.expm1(-np.abs(step) / self.reach))

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        assert memory is not None
        warm = 1.0 + self.per_kelvin * (situation.joints_c - _REFERENCE_C)
        return Deflection(joints=-self.half * warm * memory[1])


@dataclass(frozen=True, eq=False)
class ManyPlays(PlantEffect):
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


def _half(parameters: Parameters, key: str) -> Array:
    return parameters.numbers(key, least=0.0) / 2.0


def _sharp_or_gradual(parameters: Parameters) -> PlantEffect:
    parameters.require("play", optional=("reach",))
    half = _half(parameters, "play")
    gradual = parameters.all_or_none("reach")
    return SlippingElements(half, parameters.numbers("reach", above=0.0)) if gradual else TrueBacklash(half)


def _warm(play: Array, reach: Array, per_kelvin: float) -> PlantEffect:
    return WarmPlay(play, reach, per_kelvin)


backlash = by_law(
    play=_sharp_or_gradual,
    warm=made(_warm, play=_half, reach=POSITIVES, per_kelvin=NUMBER),
    many_plays=made(lambda play, reach: ManyPlays(play, reach), play=_half, reach=POSITIVES),
)
"""``play``: full width of the dead band of each joint [rad].

With ``reach`` [rad] per joint, the lost motion saturates at half the play as the last step grows beyond ``reach``.
Other laws, with ``reach``: ``law`` warm, whose play at 20 degC changes by ``per_kelvin`` [1/K]; many_plays.
"""
