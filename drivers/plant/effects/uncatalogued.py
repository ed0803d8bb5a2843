"""Effects outside the catalogue of robot errors: hoses, cables, encoder crosstalk, floors, air, a field in space."""

from __future__ import annotations

from functools import partial

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import (
    NOT_NEGATIVE,
    NUMBER,
    POSITIVE,
    SEED,
    VECTOR,
    Apparent,
    Offset,
    Parameters,
    PlantEffect,
    Situation,
    by,
    made,
    of_arms,
    on_joints,
)
from drivers.plant.mechanism import Deflection
from drivers.plant.random_functions import RandomField

_REFERENCE_C = 20.0
"""Air temperature at which a base that moves with it is at its nominal place [degC]."""


def _hose(
    situation: Situation, joint: int, angle: float, first: float, second: float, centre: float, width: float
) -> Deflection:
    """A stiff hose along the arm loads a joint in one direction or the other, with a transition in between.

    The joint turns by ``angle tanh((first q_i + second q_k - centre) / width)``, where i is the joint itself.
    """
    own, next_one = situation.q[:, joint], situation.q[:, joint + 1]
    pull = first * own + second * next_one - centre
    return on_joints(situation, joint, angle * np.tanh(pull / width))


def _three_periods(situation: Situation, joint: int, other: int, amplitude: float, phase: float) -> Deflection:
    """A joint is off with three periods per revolution of another one."""
    return on_joints(situation, joint, amplitude * np.sin(3.0 * situation.q[:, other] + phase))


def _sway(situation: Situation, shift: Array, period: float, phase: float) -> Deflection:
    """The floor moves with a machine or a thermostat nearby: the base oscillates along one line."""
    swing = np.sin(2.0 * np.pi * situation.time_s / period + phase)[:, None] * shift
    return Deflection(base=np.concatenate([swing, np.zeros_like(swing)], axis=1))


def _sag(situation: Situation, shift: Array) -> Deflection:
    """The tool's clamp yields along one direction of the flange in proportion to ``|sin q5|``."""
    sag = np.abs(np.sin(situation.q[:, 4]))[:, None] * shift
    return Deflection(tool=np.concatenate([sag, np.zeros_like(sag)], axis=1))


def _draught(p_M: Array, normal_M: Array, situation: Situation, angle: float, period: float, phase: float) -> Array:
    """Warm air crosses the beam and deflects it horizontally by an angle that is periodic in time."""
    rotation = angle * np.sin(2.0 * np.pi * situation.time_s / period + phase)
    cosine, sine = np.cos(rotation), np.sin(rotation)
    x, y, z = p_M.T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)


def _warm_floor(situation: Situation, per_kelvin: Array) -> Deflection:
    """The floor below the base moves with the air temperature: ``per_kelvin`` (3,) [m/K] from its place at 20 degC."""
    moved = (situation.air_c - _REFERENCE_C)[:, None] * per_kelvin
    return Deflection(base=np.concatenate([moved, np.zeros_like(moved)], axis=1))


def _shifted(p_M: Array, normal_M: Array, situation: Situation, rms: float, field: RandomField) -> Array:
    """Points appear shifted by a smooth random field of their position, as by layers of air or a bent tracker stand."""
    apparent: Array = p_M + rms / np.sqrt(3.0) * field.at(p_M)
    return apparent


def _coupled(
    situation: Situation, joint: int, amplitude: float, first: int, second: int, orders: Array, phases: Array
) -> Deflection:
    """Two joints together move a third one by ``amplitude sin(m q_first + phase) sin(k q_second + phase)``."""
    angles = situation.q[:, [first, second]] * orders + phases
    return on_joints(situation, joint, amplitude * np.sin(angles).prod(axis=1))


def _dress_pack(torque: float, stiffness: float, **values: float) -> PlantEffect:
    return Offset(_hose, {"joint": 0, "angle": torque / stiffness, **values})


dress_pack = of_arms(
    2,
    "a dress pack",
    made(_dress_pack, torque=NUMBER, stiffness=POSITIVE, first=NUMBER, second=NUMBER, centre=NUMBER, width=POSITIVE),
)
"""A hose that loads joint 1: ``torque`` [Nm], ``stiffness`` of the drive [Nm/rad], ``first``, ``second``, ``centre``,
``width``."""


def _elbow_hose(angle: float, share: float, centre: float, width: float) -> PlantEffect:
    own = {"joint": 2, "angle": angle, "first": 1.0, "second": share}
    return Offset(_hose, {**own, "centre": centre, "width": width})


elbow_hose = of_arms(4, "an elbow hose", made(_elbow_hose, angle=NUMBER, share=NUMBER, centre=NUMBER, width=POSITIVE))
"""A hose over the elbow and the wrist, which loads joint 3: ``angle`` [rad], ``share``, ``centre`` [rad], ``width``
[rad]."""

crosstalk = of_arms(
    5, "crosstalk", made(partial(by(Offset, _three_periods), joint=3, other=4), amplitude=NUMBER, phase=NUMBER)
)
"""The encoder of joint 4 picks up a signal of joint 5: ``amplitude``, ``phase`` [rad]."""

wrist_cable = of_arms(
    6, "a wrist cable", made(partial(by(Offset, _three_periods), joint=5, other=3), amplitude=NUMBER, phase=NUMBER)
)
"""A cable around the wrist twists joint 6 with joint 4: ``amplitude``, ``phase`` [rad]."""

base_sway = made(by(Offset, _sway), shift=VECTOR, period=POSITIVE, phase=NUMBER)
"""``shift`` (3) [m] in B: the amplitude; ``period`` [s], ``phase`` [rad]."""

tool_sag = of_arms(5, "a sagging tool", made(by(Offset, _sag), shift=VECTOR))
"""``shift`` (3) [m] in the flange frame with joint 5 at 90 degrees."""

draught = made(by(Apparent, _draught), angle=NUMBER, period=POSITIVE, phase=NUMBER)
"""``angle`` [rad]: the amplitude; ``period`` [s], ``phase`` [rad]."""

warm_floor = made(by(Offset, _warm_floor), per_kelvin=VECTOR)
"""``per_kelvin`` (3) [m/K] in B."""


def _workspace_field(rms: float, length: float, seed: int) -> PlantEffect:
    return Apparent(_shifted, {"rms": rms, "field": RandomField.sampled(seed, length)})


workspace_field = made(_workspace_field, rms=NOT_NEGATIVE, length=POSITIVE, seed=SEED)
"""``rms`` [m] of the shift, its correlation ``length`` [m] and ``seed``."""


def joint_coupling(parameters: Parameters) -> PlantEffect:
    """Build a coupling: ``joint``, ``first``, ``second`` (from 1), ``amplitude`` [rad], ``phases``, ``orders``."""
    parameters.require("joint", "first", "second", "amplitude", "phases", "orders")
    joint, first, second = (int(parameters.number(key)) for key in ("joint", "first", "second"))
    if not all(1 <= one <= parameters.joints for one in (joint, first, second)):
        raise parameters.effect_error(f"joints must be 1 to {parameters.joints}")
    orders, phases = parameters.numbers("orders", 2), parameters.numbers("phases", 2)
    values = {"amplitude": parameters.number("amplitude"), "orders": orders, "phases": phases}
    return Offset(_coupled, {"joint": joint - 1, "first": first - 1, "second": second - 1, **values})
