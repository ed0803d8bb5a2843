"""Effects outside the catalogue of robot errors: hoses, cables, encoder crosstalk, floors, air, a field in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import Effect, Parameters, Situation
from drivers.plant.mechanism import Deflection
from drivers.plant.random_functions import RandomField

_REFERENCE_C = 20.0
"""Air temperature at which a base that moves with it is at its nominal place [degC]."""


def _joint_offset(situation: Situation, joint: int, angle: Array) -> Deflection:
    offsets = np.zeros_like(situation.q)
    offsets[:, joint] = angle
    return Deflection(joints=offsets)


@dataclass(frozen=True, eq=False)
class DressPack(Effect):
    """A hose along the arm loads joint 1 in one direction or the other, with a transition in between.

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
        return _joint_offset(situation, 0, self.torque / self.stiffness * np.tanh(pull / self.width))


@dataclass(frozen=True, eq=False)
class Crosstalk(Effect):
    """The encoder of joint 4 picks up a signal of joint 5 with three periods per revolution."""

    amplitude: float
    phase: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        return _joint_offset(situation, 3, self.amplitude * np.sin(3.0 * situation.q[:, 4] + self.phase))


@dataclass(frozen=True, eq=False)
class WristCable(Effect):
    """A cable around the wrist twists joint 6 with three periods per revolution of joint 4."""

    amplitude: float
    phase: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        return _joint_offset(situation, 5, self.amplitude * np.sin(3.0 * situation.q[:, 3] + self.phase))


@dataclass(frozen=True, eq=False)
class BaseSway(Effect):
    """The floor moves with a machine or a thermostat nearby: the base oscillates along one line."""

    shift: Array
    period: float
    phase: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        swing = np.sin(2.0 * np.pi * situation.time_s / self.period + self.phase)[:, None] * self.shift
        return Deflection(base=np.concatenate([swing, np.zeros_like(swing)], axis=1))


@dataclass(frozen=True, eq=False)
class ToolSag(Effect):
    """The tool's clamp yields along one direction of the flange in proportion to ``|sin q5|``."""

    shift: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        sag = np.abs(np.sin(situation.q[:, 4]))[:, None] * self.shift
        return Deflection(tool=np.concatenate([sag, np.zeros_like(sag)], axis=1))


@dataclass(frozen=True, eq=False)
class Draught(Effect):
    """Warm air crosses the beam and deflects it horizontally by an angle that is periodic in time."""

    angle: float
    period: float
    phase: float

    def apparent_position(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        turn = self.angle * np.sin(2.0 * np.pi * situation.time_s / self.period + self.phase)
        cosine, sine = np.cos(turn), np.sin(turn)
        x, y, z = p_M.T
        return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)


@dataclass(frozen=True, eq=False)
class ElbowHose(Effect):
    """A stiff hose over the elbow and the wrist loads joint 3: ``angle tanh((q3 + share q4 - centre) / width)``."""

    angle: float
    share: float
    centre: float
    width: float

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        pull = situation.q[:, 2] + self.share * situation.q[:, 3] - self.centre
        return _joint_offset(situation, 2, self.angle * np.tanh(pull / self.width))


@dataclass(frozen=True, eq=False)
class WarmFloor(Effect):
    """The floor below the base moves with the air temperature: ``per_kelvin`` (3,) [m/K] from its place at 20 degC."""

    per_kelvin: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        moved = (situation.air_c - _REFERENCE_C)[:, None] * self.per_kelvin
        return Deflection(base=np.concatenate([moved, np.zeros_like(moved)], axis=1))


@dataclass(frozen=True, eq=False)
class WorkspaceField(Effect):
    """Points appear shifted by a smooth random field of their position, as by layers of air or a bent tracker stand."""

    rms: float  # of the shift's length
    field: RandomField

    def apparent_position(self, p_M: Array, normal_M: Array, situation: Situation) -> Array:
        apparent: Array = p_M + self.rms / np.sqrt(3.0) * self.field.at(p_M)
        return apparent


@dataclass(frozen=True, eq=False)
class JointCoupling(Effect):
    """Two joints together move a third one by ``amplitude sin(m q_first + phase) sin(k q_second + phase)``."""

    joint: int
    amplitude: float
    first: int
    second: int
    orders: Array  # m and k
    phases: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        angles = situation.q[:, [self.first, self.second]] * self.orders + self.phases
        return _joint_offset(situation, self.joint, self.amplitude * np.sin(angles).prod(axis=1))


def _require_joints(parameters: Parameters, effect: str, count: int) -> None:
    if parameters.joints < count:
        raise parameters.effect_error(f"{effect} needs an arm of at least {count} joints, not {parameters.joints}")


def dress_pack(parameters: Parameters) -> Effect:
    """Build a dress pack: ``torque`` [Nm], ``stiffness`` [Nm/rad], ``first``, ``second``, ``centre``, ``width``."""
    parameters.require("torque", "stiffness", "first", "second", "centre", "width")
    _require_joints(parameters, "a dress pack", 2)
    return DressPack(
        parameters.number("torque"),
        parameters.number("stiffness", above=0.0),
        parameters.number("first"),
        parameters.number("second"),
        parameters.number("centre"),
        parameters.number("width", above=0.0),
    )


def crosstalk(parameters: Parameters) -> Effect:
    """Build crosstalk. ``amplitude``, ``phase`` [rad]."""
    parameters.require("amplitude", "phase")
    _require_joints(parameters, "crosstalk", 5)
    return Crosstalk(parameters.number("amplitude"), parameters.number("phase"))


def wrist_cable(parameters: Parameters) -> Effect:
    """Build a wrist cable. ``amplitude``, ``phase`` [rad]."""
    parameters.require("amplitude", "phase")
    _require_joints(parameters, "a wrist cable", 6)
    return WristCable(parameters.number("amplitude"), parameters.number("phase"))


def base_sway(parameters: Parameters) -> Effect:
    """Build base sway. ``shift`` (3) [m] in B: the amplitude; ``period`` [s], ``phase`` [rad]."""
    parameters.require("shift", "period", "phase")
    return BaseSway(parameters.numbers("shift", 3), parameters.number("period", above=0.0), parameters.number("phase"))


def tool_sag(parameters: Parameters) -> Effect:
    """Build tool sag. ``shift`` (3) [m] in the flange frame with joint 5 at 90 degrees."""
    parameters.require("shift")
    _require_joints(parameters, "a sagging tool", 5)
    return ToolSag(parameters.numbers("shift", 3))


def draught(parameters: Parameters) -> Effect:
    """Build a draught. ``angle`` [rad]: the amplitude; ``period`` [s], ``phase`` [rad]."""
    parameters.require("angle", "period", "phase")
    return Draught(parameters.number("angle"), parameters.number("period", above=0.0), parameters.number("phase"))


def elbow_hose(parameters: Parameters) -> Effect:
    """Build an elbow hose: ``angle`` [rad], ``share``, ``centre`` [rad], ``width`` [rad]."""
    parameters.require("angle", "share", "centre", "width")
    _require_joints(parameters, "an elbow hose", 4)
    angle, share, centre = (parameters.number(key) for key in ("angle", "share", "centre"))
    return ElbowHose(angle, share, centre, parameters.number("width", above=0.0))


def warm_floor(parameters: Parameters) -> Effect:
    """Build a warm floor. ``per_kelvin`` (3) [m/K] in B."""
    parameters.require("per_kelvin")
    return WarmFloor(parameters.numbers("per_kelvin", 3))


def workspace_field(parameters: Parameters) -> Effect:
    """Build a field. ``rms`` [m] of the shift, its correlation ``length`` [m] and ``seed``."""
    parameters.require("rms", "length", "seed")
    field = RandomField.drawn(parameters.integer("seed", least=0), parameters.number("length", above=0.0))
    return WorkspaceField(parameters.number("rms", least=0.0), field)


def joint_coupling(parameters: Parameters) -> Effect:
    """Build a coupling: ``joint``, ``first``, ``second`` (from 1), ``amplitude`` [rad], ``phases``, ``orders``."""
    parameters.require("joint", "first", "second", "amplitude", "phases", "orders")
    joint, first, second = (int(parameters.number(key)) for key in ("joint", "first", "second"))
    if not all(1 <= one <= parameters.joints for one in (joint, first, second)):
        raise parameters.effect_error(f"joints must be 1 to {parameters.joints}")
    orders, phases = parameters.numbers("orders", 2), parameters.numbers("phases", 2)
    return JointCoupling(joint - 1, parameters.number("amplitude"), first - 1, second - 1, orders, phases)
