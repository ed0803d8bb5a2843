"""Discrepancy term of an effect: its columns times smooth functions of the effect's own inputs.

A law is never exactly right. With base column B, fitted value v and a smooth function g of an input z,

    displacement = B v (1 + g(z)),    g(z) = sum_k c_k f_k(z) / v,

f_k = cos kz, sin kz (k = 1 to 3) for an angle that closes on itself, else cos(k pi u) (k = 1 to 4) with u from 0 to 1
over the range that z had in the run. An input may be the size of B itself (k = 1 to 8), for a response that is not
proportional. So the residual of a law stays with its effect and does not look like another effect.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellapp.robot.effects.context import EffectColumn, EffectContext
from cellapp.robot.effects.data_driven import PER_JOINT, Quantity, Variable, variable_named, variables
from cellapp.robot.kinematics.transforms import Array

HARMONICS = 3
"""Highest multiple of an angle: with a law of n cycles per revolution its neighbours n - 3 to n + 3 are covered."""
HALF_CYCLES = 4
"""Most half cycles over the range of other inputs: the error of a nearly right law is smooth."""
OWN_HALF_CYCLES = 8
"""Most half cycles over the column's own size: knees of springs are resolved to an eighth of the range."""
_OWN_SIZE_NAME = "own size"
"""Name of the input that is the size of the base column itself."""
_REPRESENTATIVES: Mapping[Quantity, tuple[int, ...]] = {
    Quantity.JOINT_ANGLE: (0,),
    Quantity.TORQUE: (1, 2),
    Quantity.OTHER_JOINT_ANGLE: (0, 1, 2),
}
"""Joints that represent the whole arm: the first turns the moment on the base, the next two carry nearly all of it."""


@dataclass(frozen=True)
class TermInput:
    """A quantity that an effect's discrepancy term depends on, or its absolute value; None: the size of the column.

    Of a quantity of joints it is that of the column's own joint, or of the joints that stand for the arm where the
    column belongs to no joint.
    """

    quantity: Quantity | None
    absolute: bool = False

    def variables(self, column: EffectColumn) -> tuple[Variable | None, ...]:
        """The variables for one column."""
        if self.quantity is None:
            return (None,)
        if self.quantity not in PER_JOINT:
            return (Variable(self.quantity),)
        if column.index is not None and self.quantity is not Quantity.OTHER_JOINT_ANGLE:
            return (Variable(self.quantity, column.index),)
        return tuple(Variable(self.quantity, joint) for joint in _REPRESENTATIVES.get(self.quantity, ()))


OWN_SIZE = TermInput(None)
"""The size of the column itself: the joint offset, or the length of the SMR shift, per unit of the parameter."""


@dataclass(frozen=True)
class Modulation:
    """One column of a discrepancy term: a base column times one function of an input.

    Attributes
    ----------
    base : str
        Name of the base column.
    variable : Variable or None
        None for the size of the base column itself.
    order : int
        k, from 1.
    sine : bool
        Sine instead of cosine; angles that close on themselves only.
    absolute : bool
        Of the input's absolute value.
    low, high : float
        Range of the input in the run, in its unit; not of angles that close on themselves.
    scale : float
        Of an absolute value z: u follows ``z / (z + scale)``, which resolves small values more finely. 0: u follows z.
    """

    base: str
    variable: Variable | None
    order: int
    sine: bool = False
    absolute: bool = False
    low: float = 0.0
    high: float = 0.0
    scale: float = 0.0

    @property
    def input_name(self) -> str:
        """``q2``, ``|torque2|``, ``time``, ``own size``."""
        if self.variable is None:
            return _OWN_SIZE_NAME
        return f"|{self.variable.name}|" if self.absolute else self.variable.name

    @property
    def name(self) -> str:
        """Name of its column, for example ``half_play2*cos1(|step2|)``."""
        return f"{self.base}*{'sin' if self.sine else 'cos'}{self.order}({self.input_name})"

    def values(self, base: EffectColumn, context: EffectContext) -> Array:
        """The function (n,); 0, no modulation, where the input is unknown."""
        z = _input_values(self.variable, base, context, absolute=self.absolute)
        if closes(self.variable):
            wave = np.sin if self.sine else np.cos
            return np.asarray(np.nan_to_num(wave(self.order * z)), dtype=np.float64)
        low, high = _compressed(np.array([self.low, self.high]), self.scale).tolist()
        u = np.clip((_compressed(z, self.scale) - low) / (high - low), 0.0, 1.0)
        return np.asarray(np.nan_to_num(np.cos(self.order * np.pi * u)), dtype=np.float64)

    def column(self, base: EffectColumn, context: EffectContext) -> EffectColumn:
        """Its column, in the place and block of the base column and without bounds; the prior keeps it small."""
        along = self.values(base, context)
        return replace(
            base,
            name=self.name,
            lower=-np.inf,
            upper=np.inf,
            wave=None,
            refines=True,
            offset=None if base.offset is None else along * base.offset,
            shift_M=None if base.shift_M is None else along[:, None] * base.shift_M,
        )


def closes(variable: Variable | None) -> bool:
    """Whether an input is an angle that closes on itself after a turn."""
    return variable is not None and (variable.is_joint_angle or variable.quantity is Quantity.AZIMUTH)


def _compressed(z: Array, scale: float) -> Array:
    """``z / (z + scale)``; z itself for a scale of 0."""
    return z if scale == 0.0 else np.asarray(z / (z + scale))


def _input_values(variable: Variable | None, base: EffectColumn, context: EffectContext, *, absolute: bool) -> Array:
    """Values (n,) of an input; NaN where unknown."""
    if variable is not None:
        values = variable.values(context)
        return np.abs(values) if absolute else values
    if base.offset is not None:
        return np.abs(base.offset)
    assert base.shift_M is not None
    return np.asarray(np.linalg.norm(base.shift_M, axis=1))


def modulations(inputs: TermInput, columns: Sequence[EffectColumn], context: EffectContext) -> tuple[Modulation, ...]:
    """The modulations of some columns by one input; none where it does not vary in the run."""
    known = set(variables(context))
    found: list[Modulation] = []
    for column in columns:
        for variable in inputs.variables(column):
            if variable is None or variable in known:
                found += _of_variable(column, variable, inputs.absolute, context)
    return tuple(found)


def _of_variable(
    base: EffectColumn, variable: Variable | None, absolute: bool, context: EffectContext
) -> Iterable[Modulation]:
    if closes(variable):
        orders = range(1, HARMONICS + 1)
        return [Modulation(base.name, variable, k, sine=sine) for k in orders for sine in (False, True)]
    values = _input_values(variable, base, context, absolute=absolute)
    low, high = float(values.min()), float(values.max())
    most = min(HALF_CYCLES if variable is not None else OWN_HALF_CYCLES, len(np.unique(values)) - 1)
    # short steps and small loads leave most to see: half of the values are below the scale
    scale = float(np.median(values)) if absolute else 0.0
    return [
        Modulation(base.name, variable, k, absolute=absolute, low=low, high=high, scale=scale)
        for k in range(1, most + 1)
    ]


def with_modulations(
    columns: Sequence[EffectColumn], free: Sequence[Modulation], context: EffectContext
) -> list[EffectColumn]:
    """Columns of a law, and those of its discrepancy term after them.

    Raises
    ------
    ValueError
        If a base column is not among ``columns``.
    """
    by_name = {column.name: column for column in columns}
    missing = next((one.base for one in free if one.base not in by_name), None)
    if missing is not None:
        raise ValueError(f"a discrepancy term needs the column '{missing}', which the law does not have")
    return [*columns, *(one.column(by_name[one.base], context) for one in free)]


def modulation_to_json(one: Modulation) -> dict[str, Any]:
    """A modulation for JSON."""
    name = _OWN_SIZE_NAME if one.variable is None else one.variable.name
    return {"base": one.base, "driver": name} | {key: value for key, value in vars(one).items() if key != "variable"}


def modulation_from_json(content: Mapping[str, Any]) -> Modulation:
    """Read what ``modulation_to_json`` wrote. Raises ``ValueError`` for an input that is not known."""
    variable = variable_named(content["driver"])
    if variable is None and content["driver"] != _OWN_SIZE_NAME:
        raise ValueError(f"this version does not know the variable '{content['driver']}' of a discrepancy term")
    return Modulation(variable=variable, **{key: value for key, value in content.items() if key != "driver"})
