"""Basis functions of data-driven laws, and their constants, which are taken from a run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from cellapp.robot.effects.context import EffectContext
from cellapp.robot.effects.data_driven import (
    FIRST_CONSTANTS,
    PERIOD,
    POSITION,
    SECOND_CONSTANTS,
    Quantity,
    Variable,
    data_driven_form,
    position_in_base,
)
from cellapp.robot.effects.field import field_functions
from cellapp.robot.effects.law import Constant, Law
from cellapp.robot.effects.time_functions import run_span, with_default
from cellapp.robot.kinematics.transforms import Array

ORDER = 4
"""Highest order of the functions of one variable; higher ones would fit noise in a few hundred readings."""
TIME_ORDER = 20
"""Most half cycles over the run: a drift may change its direction twenty times."""
PAIR_ORDER = 3
"""Highest total order of the functions of two variables: 24 columns at most."""
PAIR_ORDERS = (2, PAIR_ORDER)
"""Total orders that are tried: with at most 12 columns, a weak effect in few readings can be described too."""
ANGLE_PAIR_ORDERS = (*PAIR_ORDERS, 2 * PAIR_ORDER)
"""Total orders of functions of two angles, each up to order 3: the last has all 48 products, as for two gear wheels."""


def run_constants(context: EffectContext, variable: Variable) -> dict[str, float]:
    """Return a variable's constants from the run: order, range, and a default for unknown values."""
    if variable.is_joint_angle:
        return {"order": float(ORDER)}
    if variable.quantity is Quantity.TIME:
        first, last = run_span(context).values()
        return {"order": float(TIME_ORDER), "low": first, "high": last, "typical": last}
    values = variable.values(context)
    center = {}
    if variable.quantity is Quantity.AZIMUTH:
        center = {"center": math.atan2(float(np.sin(values).mean()), float(np.cos(values).mean()))}
        values = _about(values, center["center"])
    typical = float(np.mean(values))
    if variable.quantity is Quantity.DWELL:
        typical = float(np.median(values))
    elif variable.quantity is Quantity.PAYLOAD:
        typical = context.bodies.payload_mass
    elif variable.quantity is Quantity.STEP:
        typical = 0.0
    order = float(min(ORDER, len(np.unique(values)) - 1))
    return {"order": order, "low": float(values.min()), "high": float(values.max()), "typical": typical, **center}


def _about(azimuth: Array, center: float) -> Array:
    """Compute azimuths (n,) relative to a centre, -pi to pi: no jump within the cell, whatever the tracker's x axis."""
    return np.asarray(np.remainder(azimuth - center + np.pi, 2.0 * np.pi) - np.pi)


def functions(context: EffectContext, law: Law) -> dict[str, Array]:
    """Evaluate the functions (n,) of a law's variables, by name."""
    return FunctionTable(context).functions(data_driven_form(law).drivers, law.constants)


@dataclass(frozen=True, eq=False)
class FunctionTable:
    """Functions of data-driven laws at the stops of a context; those of one variable are evaluated once for all pairs.

    ``families`` and ``waves`` are caches.
    """

    context: EffectContext
    families: dict[tuple[Variable, float], list[tuple[int, str, Array]]] = field(default_factory=dict)
    waves: dict[Variable, NDArray[np.complex128]] = field(default_factory=dict)

    def functions(self, drivers: tuple[Variable, ...], constants: Mapping[str, float]) -> dict[str, Array]:
        """Evaluate the functions (n,) of some variables, by name."""
        if drivers == POSITION:
            return field_functions(position_in_base(self.context), constants)
        first = _own(constants, FIRST_CONSTANTS, "")
        if len(drivers) == 1:
            if drivers[0].quantity is Quantity.TIME:
                return _of_time(self.context, drivers[0], first)
            return {name: values for _, name, values in self._family(drivers[0], first)}
        if all(one.is_joint_angle for one in drivers):
            return self._of_two_angles(drivers, round(constants["order"]))
        second = _own(constants, SECOND_CONSTANTS, "2")
        most = round(max(first["order"], second["order"]))
        ones = [(0, "", np.ones(len(self.context)))]
        products = {}
        for m, left, f in ones + self._family(drivers[0], first):
            for k, right, g in ones + self._family(drivers[1], second):
                if 1 <= m + k <= most:
                    products["*".join(filter(None, (left, right)))] = f * g
        return products

    def _family(self, variable: Variable, constants: Mapping[str, float]) -> list[tuple[int, str, Array]]:
        key = (variable, constants["order"])
        if key not in self.families:
            self.families[key] = _family(self.context, variable, constants)
        return self.families[key]

    def _of_two_angles(self, drivers: tuple[Variable, ...], order: int) -> dict[str, Array]:
        """Evaluate cosine and sine of m v + k w, 1 <= |m| + |k| <= ``order``, each at most 3, opposite signs once."""
        v, w = (self._waves(one) for one in drivers)
        labels = tuple(one.name.replace(" ", "_") for one in drivers)
        found = {}
        for m, k, text in _phases(labels, order):
            wave = v[m] * (w[k] if k >= 0 else w[-k].conj())
            found[f"cos({text})"], found[f"sin({text})"] = wave.real, wave.imag
        return found

    def _waves(self, angle: Variable) -> NDArray[np.complex128]:
        """Evaluate ``exp(i m v)`` for m = 0 to 3 (4, n); zero, its mean over a turn, if the angle is unknown."""
        if angle not in self.waves:
            values = angle.values(self.context)
            waves = np.exp(1j * np.arange(PAIR_ORDER + 1)[:, None] * values)
            self.waves[angle] = np.where(np.isfinite(values), waves, 0.0)
        return self.waves[angle]


def _own(constants: Mapping[str, float], declared: Iterable[Constant], suffix: str) -> dict[str, float]:
    """Return the constants of one variable, without the suffix of the second."""
    return {one.name.removesuffix(suffix): constants[one.name] for one in declared if one.name in constants}


def _family(context: EffectContext, variable: Variable, constants: Mapping[str, float]) -> list[tuple[int, str, Array]]:
    """Return order, name and values (n,) of the functions of one variable; zero if an angle is unknown."""
    label, order = variable.name.replace(" ", "_"), round(constants["order"])
    if variable.is_joint_angle:
        angle = variable.values(context)
        return [
            (m, f"{letter}{m}_{label}", np.asarray(np.nan_to_num(wave(m * angle)), dtype=np.float64))
            for m in range(1, order + 1)
            for letter, wave in (("cos", np.cos), ("sin", np.sin))
        ]
    polynomials = np.asarray(legvander(2.0 * _unit(context, variable, constants) - 1.0, order), dtype=np.float64)
    return [(m, f"p{m}_{label}", polynomials[:, m]) for m in range(1, order + 1)]


def _unit(context: EffectContext, variable: Variable, constants: Mapping[str, float]) -> Array:
    """Scale a variable (n,) to 0 to 1 over its range in the run, constant beyond."""
    values = variable.values(context)
    if variable.quantity is Quantity.AZIMUTH:
        values = _about(values, constants["center"])
    low, high = constants["low"], constants["high"]
    return np.clip((with_default(values, constants["typical"], len(context)) - low) / (high - low), 0.0, 1.0)


def _of_time(context: EffectContext, time: Variable, constants: Mapping[str, float]) -> dict[str, Array]:
    """Evaluate a line and half cycles over the run, or one period."""
    x = _unit(context, time, constants)
    if PERIOD.name in constants:
        phase = 2.0 * np.pi * x * (constants["high"] - constants["low"]) / constants[PERIOD.name]
        return {"cos_time": np.cos(phase), "sin_time": np.sin(phase)}
    half_cycles = range(1, round(constants["order"]) + 1)
    return {"linear_time": 2.0 * x - 1.0} | {f"cos{k}_time": np.cos(np.pi * k * x) for k in half_cycles}


@lru_cache(maxsize=256)
def _phases(labels: tuple[str, ...], order: int) -> tuple[tuple[int, int, str], ...]:
    """List m, k and the text of each m v + k w."""
    return tuple(
        (m, k, _phase_text(m, k, labels))
        for m in range(min(order, PAIR_ORDER) + 1)
        for k in range(max(m - order, -PAIR_ORDER), min(order - m, PAIR_ORDER) + 1)
        if m > 0 or k > 0
    )


def _phase_text(m: int, k: int, labels: tuple[str, ...]) -> str:
    """``2*q1-q2`` and the like."""
    terms = [f"{count:+d}*{label}" for count, label in zip((m, k), labels, strict=True) if count]
    return "".join(terms).replace("+1*", "+").replace("-1*", "-").removeprefix("+")
