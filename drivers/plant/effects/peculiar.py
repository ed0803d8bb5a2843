"""Laws that no catalogue of robot errors holds: hoses, cables, stray couplings, a swaying floor, a draught."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection


def _at_joint(situation: Situation, joint: int, angle: Array) -> Deflection:
    offsets = np.zeros_like(situation.q)
    offsets[:, joint] = angle
    return Deflection(joints=offsets)


@dataclass(frozen=True, eq=False)
class DressPack(Effect):
    """A hose along the arm pulls joint 1 one way or the other and slips over in between.

    Its torque is ``torque * tanh((first q1 + second q2 - centre) / width)`` against the drive's stiffness.
    """

    torque: float
    stiffness: float
    first: float
    second: float
    centre: float
    width: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        pull = self.first * situation.q[:, 0] + self.second * situation.q[:, 1] - self.centre
        return _at_joint(situation, 0, self.torque / self.stiffness * np.tanh(pull / self.width))


@dataclass(frozen=True, eq=False)
class Crosstalk(Effect):
    """The encoder of joint 4 picks up a signal of joint 5 with three periods a turn."""

    amplitude: float
    phase: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        return _at_joint(situation, 3, self.amplitude * np.sin(3.0 * situation.q[:, 4] + self.phase))


@dataclass(frozen=True, eq=False)
class WristCable(Effect):
    """A cable wound about the wrist twists joint 6 as joint 4 turns, three times a turn."""

    amplitude: float
    phase: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        return _at_joint(situation, 5, self.amplitude * np.sin(3.0 * situation.q[:, 3] + self.phase))


@dataclass(frozen=True, eq=False)
class BaseSway(Effect):
    """The floor breathes with a machine or a thermostat next door: the base goes to and fro along one line."""

    shift: Array
    period: float
    phase: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        swing = np.sin(2.0 * np.pi * situation.time_s / self.period + self.phase)[:, None] * self.shift
        return Deflection(base=np.concatenate([swing, np.zeros_like(swing)], axis=1))


@dataclass(frozen=True, eq=False)
class ToolSag(Effect):
    """The tool's clamp gives way along one line of the flange as joint 5 turns it from its rest: by ``|sin q5|``."""

    shift: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        sag = np.abs(np.sin(situation.q[:, 4]))[:, None] * self.shift
        return Deflection(tool=np.concatenate([sag, np.zeros_like(sag)], axis=1))


@dataclass(frozen=True, eq=False)
class Draught(Effect):
    """Warm air drifts across the beam now and again and bends it aside, level, by an angle periodic in time."""

    angle: float
    period: float
    phase: float

    def seen(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        turn = self.angle * np.sin(2.0 * np.pi * situation.time_s / self.period + self.phase)
        cosine, sine = np.cos(turn), np.sin(turn)
        x, y, z = p_M.T
        return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)


def _demand_joints(parameters: Parameters, effect: str, count: int) -> None:
    if parameters.joints < count:
        raise parameters.unfit(f"{effect} needs an arm of at least {count} joints, not {parameters.joints}")


def dress_pack(parameters: Parameters) -> Effect:
    """``torque`` [Nm], ``stiffness`` [Nm/rad], ``first``, ``second`` [1], ``centre``, ``width`` [rad]."""
    parameters.only("torque", "stiffness", "first", "second", "centre", "width")
    _demand_joints(parameters, "a dress pack", 2)
    return DressPack(
        parameters.number("torque"),
        parameters.number("stiffness", above=0.0),
        parameters.number("first"),
        parameters.number("second"),
        parameters.number("centre"),
        parameters.number("width", above=0.0),
    )


def crosstalk(parameters: Parameters) -> Effect:
    """``amplitude``, ``phase`` [rad]."""
    parameters.only("amplitude", "phase")
    _demand_joints(parameters, "crosstalk", 5)
    return Crosstalk(parameters.number("amplitude"), parameters.number("phase"))


def wrist_cable(parameters: Parameters) -> Effect:
    """``amplitude``, ``phase`` [rad]."""
    parameters.only("amplitude", "phase")
    _demand_joints(parameters, "a wrist cable", 6)
    return WristCable(parameters.number("amplitude"), parameters.number("phase"))


def base_sway(parameters: Parameters) -> Effect:
    """``shift`` (3) [m] in B at the turning point, ``period`` [s], ``phase`` [rad]."""
    parameters.only("shift", "period", "phase")
    return BaseSway(parameters.numbers("shift", 3), parameters.number("period", above=0.0), parameters.number("phase"))


def tool_sag(parameters: Parameters) -> Effect:
    """``shift`` (3) [m] in the flange frame where joint 5 stands square."""
    parameters.only("shift")
    _demand_joints(parameters, "a sagging tool", 5)
    return ToolSag(parameters.numbers("shift", 3))


def draught(parameters: Parameters) -> Effect:
    """``angle`` [rad] at the turning point, ``period`` [s], ``phase`` [rad]."""
    parameters.only("angle", "period", "phase")
    return Draught(parameters.number("angle"), parameters.number("period", above=0.0), parameters.number("phase"))
