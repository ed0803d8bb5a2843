"""Drifts and steps of the base, the tracker and the SMR's seat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.lines import carry, rigid
from drivers.plant.mechanism import Deflection

_LAWS = ("linear", "exponential", "creep")


@dataclass(frozen=True, eq=False)
class Course:
    """Course of a drift over time: linear (1 at ``time``), exponential (towards 1), or logarithmic creep.

    Creep is ``log(1 + t / time)``, as of a bolted joint that settles under a constant load.
    """

    law: str
    time: float

    def share(self, time_s: Array) -> Array:
        """Return the share (n,) of the full drift at times (n,) [s]."""
        t = np.maximum(time_s, 0.0) / self.time
        shares: Array = {"linear": t, "exponential": -np.expm1(-t), "creep": np.log1p(t)}[self.law]
        return shares


@dataclass(frozen=True, eq=False)
class BaseDrift(Effect):
    """The base drifts from its pose at time 0. Sizes: 10 to 50 um in a run (an estimate)."""

    twist: Array
    course: Course

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        return Deflection(base=self.course.share(situation.time_s)[:, None] * self.twist)


@dataclass(frozen=True, eq=False)
class TrackerDrift(Effect):
    """The tracker drifts in its own frame as it warms up, so that points at rest appear to move the opposite way.

    A published warm-up error is tenths of a millimetre within two hours; 10 to 40 um remain afterwards (an estimate).
    """

    twist: Array
    course: Course

    def apparent_position(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        return carry(rigid(-self.course.share(situation.time_s)[:, None] * self.twist), p_M)


@dataclass(frozen=True, eq=False)
class BaseStep(Effect):
    """The base slips at ``time`` to another pose. Sizes: 10 to 50 um (an estimate)."""

    twist: Array
    time: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        return Deflection(base=np.where((situation.time_s >= self.time)[:, None], self.twist, 0.0))


@dataclass(frozen=True, eq=False)
class TargetSlip(Effect):
    """The SMR's seat slips at ``time`` on the flange. Sizes: 20 to 200 um (an estimate)."""

    shift: Array
    time: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        slipped = np.where((situation.time_s >= self.time)[:, None], self.shift, 0.0)
        return Deflection(tool=np.concatenate([slipped, np.zeros_like(slipped)], axis=1))


def _twist(parameters: Parameters) -> Array:
    return np.concatenate([parameters.numbers("shift", 3), parameters.numbers("turn", 3)])


def _course(parameters: Parameters) -> Course:
    return Course(parameters.choice("law", *_LAWS), parameters.number("time", above=0.0))


def base_drift(parameters: Parameters) -> Effect:
    """Build base drift: ``shift`` (3) [m], ``turn`` (3) [rad] in B; ``law`` linear, exponential, creep; ``time``."""
    parameters.require("shift", "turn", "law", "time")
    return BaseDrift(_twist(parameters), _course(parameters))


def tracker_drift(parameters: Parameters) -> Effect:
    """Build tracker drift; parameters as of ``base_drift``, in M."""
    parameters.require("shift", "turn", "law", "time")
    return TrackerDrift(_twist(parameters), _course(parameters))


def base_step(parameters: Parameters) -> Effect:
    """Build a base step. ``shift`` (3) [m] and ``turn`` (3) [rad] in B at ``time`` [s]."""
    parameters.require("shift", "turn", "time")
    return BaseStep(_twist(parameters), parameters.number("time"))


def target_slip(parameters: Parameters) -> Effect:
    """Build a target slip. ``shift`` (3) in the flange frame [m] at ``time`` [s]."""
    parameters.require("shift", "time")
    return TargetSlip(parameters.numbers("shift", 3), parameters.number("time"))
