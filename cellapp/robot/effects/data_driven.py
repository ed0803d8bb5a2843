"""Forms of data-driven laws: what they act on depends on which one or two variables, or on the position.

In JSON such a law is named ``place|variable`` or ``place|variable|variable``; a field over the workspace is named
``base shift|x|y|z``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.effects.context import ActsOn, EffectContext, place_name, varies
from cellapp.robot.effects.law import AMPLITUDE, FIXED, Constant, InputVariable, Law, LawForm
from cellapp.robot.effects.time_functions import times_known
from cellapp.robot.kinematics.transforms import Array

# -- A smooth vector field over the workspace: products of cosines with the spectrum of a Gaussian process ------------
#
# On a box with sides L_a the functions
#
#     f_k(x) = prod_a c cos(pi k_a (x_a - low_a) / L_a),   k_a = 0, 1, ...,   c = sqrt(2) where k_a > 0, else 1
#
# are orthogonal with a mean square of one. With independent coefficients of variance
#
#     a^2 w_k,   w_k proportional to (5 / l^2 + |omega_k|^2)^-4,   omega_a = pi k_a / L_a,   sum over k = 1
#
# the mean square of the field over the box is a^2, and its spectrum that of the Matern-5/2 covariance of length scale
# l in three dimensions (Hilbert-space features: Solin, Sarkka, Statistics and Computing 30 (2020) 419). The constant
# function is left out: it is a shift of the base. The slope of such a sum across the faces of the box is zero, so that
# the box is wider than the readings.

FIELD_LENGTH = Constant("length", "m", FIXED, "correlated over {} m")
BOX = tuple(Constant(f"{end}_{axis}", "m", FIXED) for axis in "xyz" for end in ("low", "high"))
"""Least and largest coordinate of the readings along each axis."""
FIELD_CONSTANTS = (*BOX, AMPLITUDE, FIELD_LENGTH)
_WAVES = 80
"""Number of functions per component: in a box of 3 x 3 x 2 m they resolve periods down to 1 m. Shorter periods have 1 %
of the variance of a field with a length scale of 0.4 m."""
_MARGIN = 0.15
"""Share of each side by which the box exceeds the readings at either end."""
_LEAST_SIDE = 1e-3
"""Least margin of the box [m]: readings in a plane have no function across it."""
_MOST_WAVES_A_SIDE = 16
"""Number of half waves along a side that are considered; the ``_WAVES`` slowest of a usual box have at most 8."""


def box_of(position: Array) -> dict[str, float]:
    """Return the box around positions (n, 3) [m] as the constants ``BOX``."""
    ends = np.stack([position.min(axis=0), position.max(axis=0)], axis=1).ravel()
    return dict(zip((one.name for one in BOX), ends.tolist(), strict=True))


def field_functions(position: Array, constants: Mapping[str, float]) -> dict[str, Array]:
    """Evaluate the functions at positions (n, 3) [m], each (n,), by name; beyond the box as on its nearest face."""
    low, side = _extended_box(constants)
    counts, _ = _waves(tuple(side.tolist()))
    unit = np.clip((position - low) / side, 0.0, 1.0)
    orders = np.arange(counts.max() + 1)
    cosines = np.cos(np.pi * unit[:, :, None] * orders) * np.where(orders > 0, np.sqrt(2.0), 1.0)
    values = cosines[:, 0, counts[:, 0]] * cosines[:, 1, counts[:, 1]] * cosines[:, 2, counts[:, 2]]
    names = [f"cos({i},{j},{k})" for i, j, k in counts.tolist()]
    return dict(zip(names, np.ascontiguousarray(values.T), strict=True))


def field_frequencies(constants: Mapping[str, float]) -> Array:
    """Return the angular frequency |omega_k| [1/m] of each function."""
    _, side = _extended_box(constants)
    return _waves(tuple(side.tolist()))[1]


def field_variances(length: float, frequencies: Array) -> Array:
    """Compute relative prior variances w_k at a length scale [m]; their sum is 1."""
    spectrum = (5.0 / length**2 + frequencies**2) ** -4
    return np.asarray(spectrum / spectrum.sum())


def _extended_box(constants: Mapping[str, float]) -> tuple[Array, Array]:
    """Return lower corner and sides (3,) [m] of the box of the functions."""
    ends = np.array([constants[one.name] for one in BOX]).reshape(3, 2)
    margin = np.maximum(_MARGIN * (ends[:, 1] - ends[:, 0]), _LEAST_SIDE)
    return ends[:, 0] - margin, ends[:, 1] - ends[:, 0] + 2.0 * margin


@lru_cache(maxsize=64)
def _waves(side: tuple[float, float, float]) -> tuple[NDArray[np.intp], Array]:
    """Return half waves along each side (m, 3) and frequencies (m,) of the slowest functions, without the constant."""
    counts = np.indices((_MOST_WAVES_A_SIDE,) * 3).reshape(3, -1).T[1:]
    frequencies = np.linalg.norm(np.pi * counts / np.array(side), axis=1)
    slowest = np.argsort(frequencies, kind="stable")[:_WAVES]
    return counts[slowest].astype(np.intp), np.asarray(frequencies[slowest])


_ROUNDING = 1e-6
"""A torque that varies by less [Nm] varies by rounding errors."""
_STILL = 1e-9
"""A distance or angle that varies by less [m, rad] does not vary."""


class Direction(Enum):
    """Direction in which a data-driven law acts; base and tool axes are their own."""

    SHIFT_X = "shift x"
    SHIFT_Y = "shift y"
    SHIFT_Z = "shift z"
    TURN_X = "turn x"
    TURN_Y = "turn y"
    RADIAL = "radial"
    AZIMUTH = "azimuth"
    ELEVATION = "elevation"


_SHIFTS = (Direction.SHIFT_X, Direction.SHIFT_Y, Direction.SHIFT_Z)
_TURNS = (Direction.TURN_X, Direction.TURN_Y)  # about the base's z it is an offset of joint 1
_TRACKER = (Direction.RADIAL, Direction.AZIMUTH, Direction.ELEVATION)


@dataclass(frozen=True)
class ActedOn:
    """What a data-driven law acts on.

    ``joint`` (from 0) with ``ActsOn.JOINT``; else ``direction``, None for a shift in any direction.
    """

    acts_on: ActsOn
    direction: Direction | None = None
    joint: int | None = None

    @cached_property
    def name(self) -> str:
        """``joint 2``, ``base shift``, ``base turn x``, ``tool``, ``tool y``, ``tracker radial``."""
        if self.acts_on is ActsOn.JOINT:
            return place_name(self.acts_on, self.joint)
        if self.acts_on is ActsOn.TOOL:
            return "tool" if self.direction is None else f"tool {self.direction.value[-1]}"
        return f"{self.acts_on.value} {'shift' if self.direction is None else self.direction.value}"

    @property
    def directions(self) -> tuple[Direction, ...]:
        """The directions that it combines; none for a joint."""
        if self.acts_on is ActsOn.JOINT:
            return ()
        return _SHIFTS if self.direction is None else (self.direction,)

    @property
    def parts(self) -> tuple[ActedOn, ...]:
        """One for each direction."""
        return tuple(ActedOn(self.acts_on, one) for one in self.directions)

    @property
    def subject(self) -> ActedOn:
        """What it acts on, regardless of a shift's direction: terms with one subject are about the same motion."""
        return ActedOn(self.acts_on) if self.direction in _SHIFTS else self


@lru_cache(maxsize=8)
def acted_on(joints: int) -> tuple[ActedOn, ...]:
    """All that laws act on, of an arm with N joints."""
    base = [ActedOn(ActsOn.BASE, one) for one in (*_SHIFTS, *_TURNS)]
    return (
        *(ActedOn(ActsOn.JOINT, joint=j) for j in range(joints)),
        ActedOn(ActsOn.BASE),
        ActedOn(ActsOn.TOOL),
        *base,
        *(ActedOn(ActsOn.TOOL, one) for one in _SHIFTS),
        *(ActedOn(ActsOn.TRACKER, one) for one in _TRACKER),
    )


def position_in_base(context: EffectContext) -> Array:
    """SMR positions in the base frame (n, 3) [m]."""
    rotations, origins = context.frames
    return np.asarray(np.einsum("nba,nb->na", rotations[0], context.p_M - origins[0]))


def _incidence(context: EffectContext) -> Array | None:
    """Angle between the SMR's axis and the direction back to the tracker (n,) [rad]."""
    if context.smr_normal is None:
        return None
    back = -np.einsum("na,na->n", context.frames[0][-1] @ context.smr_normal, context.beam[1])
    return np.asarray(np.arccos(np.clip(back, -1.0, 1.0)))


_DEG = float(np.degrees(1.0))


class Quantity(Enum):
    """What a variable of a data-driven law measures.

    Attributes
    ----------
    value : str
    input : InputVariable
        What effects that depend on it share.
    of : callable
        Takes it from a context: (n,), or (n, N) where there is one per joint; None if it is not known.
    label : str
        Axis of a figure, with a placeholder for the joint.
    factor : float
        From SI units to those of the label.
    words : str
        How people call it, if not by its value.
    """

    JOINT_ANGLE = "q", InputVariable.JOINT_ANGLE, lambda its: its.q, "joint {} [deg]", _DEG
    OTHER_JOINT_ANGLE = (
        *("other q", InputVariable.OTHER_ARM, lambda its: its.conditions.other_q),
        *("joint {} of the other arm [deg]", _DEG),
    )
    TIME = "time", InputVariable.TIME, lambda its: its.conditions.time_s, "time [h]", 1.0 / 3600.0
    TORQUE = "torque", InputVariable.TORQUE, lambda its: its.torques, "gravity torque on joint {} [Nm]"
    STEP = "step", InputVariable.STEP, lambda its: its.step, "last step of joint {} [deg]", _DEG
    DWELL = "dwell", InputVariable.DWELL, lambda its: its.conditions.dwell_s, "dwell [s]", 1.0, "the dwell"
    PAYLOAD = "payload", InputVariable.PAYLOAD, lambda its: its.payload_kg, "payload [kg]", 1.0, "the payload"
    TEMPERATURE = (
        *("temperature", InputVariable.AIR_TEMPERATURE, lambda its: its.conditions.air_c),
        *("air temperature [degC]", 1.0, "the air temperature"),
    )
    RANGE = (
        *("range", InputVariable.BEAM, lambda its: its.beam[0]),
        *("distance from the tracker [m]", 1.0, "the distance from the tracker"),
    )
    AZIMUTH = (
        *("azimuth", InputVariable.BEAM, lambda its: its.across[0]),
        *("azimuth seen by the tracker [deg]", _DEG, "the tracker's azimuth"),
    )
    ELEVATION = (
        *("elevation", InputVariable.BEAM, lambda its: its.across[1]),
        *("elevation seen by the tracker [deg]", _DEG, "the tracker's elevation"),
    )
    INCIDENCE = "incidence", InputVariable.INCIDENCE, _incidence, "incidence [deg]", _DEG, "the angle of incidence"
    # where the SMR is, seen from the base or from the tracker
    X = "x", InputVariable.BEAM, lambda its: position_in_base(its)[:, 0].copy(), "x in the base frame [m]"
    Y = "y", InputVariable.BEAM, lambda its: position_in_base(its)[:, 1].copy(), "y in the base frame [m]"
    Z = "z", InputVariable.BEAM, lambda its: position_in_base(its)[:, 2].copy(), "z in the base frame [m]"

    input: InputVariable
    of: Callable[[EffectContext], Array | None]
    label: str
    factor: float
    words: str

    def __new__(
        cls,
        value: str,
        input: InputVariable,
        of: Callable[[EffectContext], Array | None],
        label: str,
        factor: float = 1.0,
        words: str = "",
    ) -> Quantity:
        made = object.__new__(cls)
        made._value_, made.input, made.of, made.label, made.factor = value, input, of, label, factor
        made.words = words or value
        return made


PER_JOINT = frozenset({Quantity.JOINT_ANGLE, Quantity.OTHER_JOINT_ANGLE, Quantity.TORQUE, Quantity.STEP})
"""Quantities of which there is one per joint."""


@dataclass(frozen=True)
class Variable:
    """A variable of data-driven laws; ``joint`` (from 0) where there is one per joint."""

    quantity: Quantity
    joint: int | None = None

    @cached_property
    def name(self) -> str:
        """``q1``, ``other q3``, ``torque2``, ``time``."""
        return self.quantity.value if self.joint is None else f"{self.quantity.value}{self.joint + 1}"

    @property
    def is_joint_angle(self) -> bool:
        """Whether it is a joint angle, of this arm or the other: functions of it are periodic."""
        return self.quantity in (Quantity.JOINT_ANGLE, Quantity.OTHER_JOINT_ANGLE)

    @property
    def is_angle(self) -> bool:
        """Whether it is any angle."""
        return self.is_joint_angle or self.quantity in (Quantity.AZIMUTH, Quantity.ELEVATION, Quantity.INCIDENCE)

    def values(self, context: EffectContext) -> Array:
        """Values (n,); NaN where unknown."""
        found = self.quantity.of(context)
        if found is None:
            return np.full(len(context), np.nan)
        return np.asarray(found if self.joint is None else found[:, self.joint])


POSITION = (Variable(Quantity.X), Variable(Quantity.Y), Variable(Quantity.Z))
"""Where in the workspace the SMR is, in the base frame."""


def variables(context: EffectContext) -> tuple[Variable, ...]:
    """The variables that are known at all stops and vary."""
    conditions = context.conditions

    def per_joint(quantity: Quantity, values: Array, least: float = 0.0) -> list[Variable]:
        return [Variable(quantity, j) for j in range(values.shape[1]) if np.ptp(values[:, j]) > least]

    found = per_joint(Quantity.JOINT_ANGLE, context.q)
    if conditions.other_q is not None and varies(conditions.other_q):
        found += per_joint(Quantity.OTHER_JOINT_ANGLE, conditions.other_q)
    if times_known(context):
        found.append(Variable(Quantity.TIME))
    found += per_joint(Quantity.TORQUE, context.torques, _ROUNDING)
    if varies(conditions.step):
        found += per_joint(Quantity.STEP, context.step)
    optional = (
        (Quantity.DWELL, conditions.dwell_s),
        (Quantity.PAYLOAD, conditions.payload_kg),
        (Quantity.TEMPERATURE, conditions.air_c),
    )
    found += [Variable(quantity) for quantity, values in optional if varies(values)]
    seen = [Quantity.RANGE, Quantity.AZIMUTH, Quantity.ELEVATION]
    if context.smr_normal is not None:
        seen.append(Quantity.INCIDENCE)
    found += [one for one in map(Variable, seen) if np.ptp(one.values(context)) > _STILL]
    return tuple(found)


# -- laws ------------------------------------------------------------------------------------------------------------


def _constants(suffix: str) -> tuple[Constant, ...]:
    """Declarations for one variable, in its SI unit; ``suffix`` is 2 for the second."""
    optional = tuple(Constant(f"{name}{suffix}", "", FIXED, optional=True) for name in ("low", "high", "typical"))
    order = Constant(f"order{suffix}", "", FIXED, optional=bool(suffix))
    return (order, *optional, Constant(f"center{suffix}", "rad", FIXED, optional=True))


PERIOD = Constant("period_s", "s", FIXED, "period {} min", factor=1.0 / 60.0, optional=True)
FIRST_CONSTANTS = (*_constants(""), PERIOD)
SECOND_CONSTANTS = _constants("2")


@dataclass(frozen=True)
class DataDrivenForm(LawForm):
    """The form of a data-driven law: what it acts on and one or two inputs, or the three of the position."""

    acts_on: ActedOn = field(kw_only=True)
    inputs: tuple[Variable, ...] = field(kw_only=True)

    @property
    def is_field(self) -> bool:
        """Whether it is a field over the workspace."""
        return self.inputs == POSITION

    @property
    def subject(self) -> tuple[ActedOn, tuple[Variable, ...]]:
        """What it acts on, regardless of a shift's direction, and variables."""
        return self.acts_on.subject, self.inputs


@lru_cache(maxsize=16384)
def form_of(acts_on: ActedOn, inputs: tuple[Variable, ...]) -> DataDrivenForm:
    """The form of inputs and what it acts on; cached, as a search makes the same thousands repeatedly."""
    names = [one.name for one in inputs]
    of = "the position, a field over the workspace" if inputs == POSITION else " and ".join(names)
    return DataDrivenForm(
        name="|".join([acts_on.name, *names]),
        words=f"{acts_on.name} as a function of {of}",
        constants=FIELD_CONSTANTS if inputs == POSITION else FIRST_CONSTANTS + SECOND_CONSTANTS,
        variables=frozenset(one.quantity.input for one in inputs),
        acts_on=acts_on,
        inputs=inputs,
    )


FIELD = form_of(ActedOn(ActsOn.BASE), POSITION)
"""A field over the workspace. A shift seen in the tracker's frame is the same field, with other coordinates."""


def data_driven_form(law: Law) -> DataDrivenForm:
    """The form of a data-driven law."""
    assert isinstance(law.form, DataDrivenForm)
    return law.form


_NUMBERED = re.compile(r"(.*?)(\d+)")


def form_named(name: str) -> DataDrivenForm | None:
    """The form of a name in JSON, the one place that reads such names; None if it is not one."""
    first, *rest = name.split("|")
    acts_on = _acted_on_named(first)
    found = [variable_named(one) for one in rest]
    inputs = tuple(one for one in found if one is not None)
    if acts_on is None or len(inputs) < len(rest):
        return None
    if inputs == FIELD.inputs:
        return FIELD if acts_on == FIELD.acts_on else None
    if not 1 <= len(rest) <= 2 or set(inputs) & set(POSITION):
        return None
    return form_of(acts_on, inputs)


def _acted_on_named(name: str) -> ActedOn | None:
    numbered = _NUMBERED.fullmatch(name)
    joints = int(numbered[2]) if numbered else 0
    return next((one for one in acted_on(joints) if one.name == name), None)


def variable_named(name: str) -> Variable | None:
    """The variable of a name such as ``torque2``; None if it is not one."""
    numbered = _NUMBERED.fullmatch(name)
    text, joint = (name, None) if numbered is None else (numbered[1], int(numbered[2]) - 1)
    quantity = next((one for one in Quantity if one.value == text), None)
    if quantity is None or (quantity in PER_JOINT) != (joint is not None) or joint == -1:
        return None
    return Variable(quantity, joint)
