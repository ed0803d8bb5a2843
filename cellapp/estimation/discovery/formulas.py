"""Short formulas that may describe a data-driven term: functions of one or two variables with a free factor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.robot.effects.data_driven import Quantity, Variable
from cellapp.robot.kinematics.transforms import Array

_PERIOD_COUNTS = np.arange(0.5, 24.25, 0.25)
"""Numbers of periods of an oscillation in the run, in steps of a quarter: finer than a run of few periods resolves."""
_DECAY_SHARES = (0.05, 0.1, 0.2, 0.4, 0.8)
"""Time constants of a decay as shares of the run: shorter ones cover too few stops, longer ones are straight lines."""
_HARMONICS = 8
"""Highest harmonic of an angle."""
_ABSOLUTE_HARMONICS = 4
"""Highest harmonic of an absolute sine or cosine, which has twice as many cycles."""
_STEP_WIDTHS = (0.1, 0.2, 0.4, 0.8)
"""Widths of a smooth step as shares of a variable's range."""
_PAIR_STEP_WIDTHS = (0.3, 0.6, 1.0, 1.6)
"""Widths of a smooth step of two angles [rad]."""
_PAIR_FACTORS = ((1, 1), (1, -1), (1, 0.5), (0.5, 1), (1, -0.5), (0.5, -1), (2, 1), (1, 2))
"""Factors of two variables in one argument: sums and differences, as for coupled joints, with factors 1, 2 and 1/2."""


@dataclass(frozen=True, eq=False)
class Formula:
    """A formula: its text, and the values (n, k) of its k functions, each with a free factor."""

    text: str
    values: Array


def formulas(variables: Sequence[Variable], values: Sequence[Array]) -> list[Formula]:
    """Generate formulas of one or two variables whose values (n,) are finite and vary."""
    found: list[Formula] = []
    for variable, x in zip(variables, values, strict=True):
        name = variable.name
        found += [Formula(f"c {name}", x[:, None]), Formula(f"c {name}^2", x[:, None] ** 2)]
        found.append(Formula(f"c |{name}|", np.abs(x)[:, None]))
        found += _of_time(x) if variable.quantity is Quantity.TIME else _of_one(variable, x)
    if len(variables) == 2:
        found += _of_two(variables[0].name, variables[1].name, values[0], values[1])
    return [one for one in found if np.isfinite(one.values).all() and np.ptp(one.values, axis=0).max() > 0.0]


def _of_time(t: Array) -> Iterator[Formula]:
    """Generate oscillations and decays."""
    run_s = float(np.ptp(t)) or 1.0
    for count in _PERIOD_COUNTS:
        period = run_s / float(count)
        yield Formula(f"c sin(2 pi time / {period / 60.0:.3g} min + phase)", _waves(2.0 * np.pi * t / period))
    for share in _DECAY_SHARES:
        text = f"c exp(-time / {share * run_s / 60.0:.3g} min)"
        yield Formula(text, np.exp(-(t - t.min()) / (share * run_s))[:, None])


def _of_one(variable: Variable, x: Array) -> Iterator[Formula]:
    """Generate harmonics of an angle and their absolute values; smooth steps of any variable."""
    name, is_angle = variable.name, variable.is_angle
    for k in range(1, _HARMONICS + 1 if is_angle else 1):
        yield Formula(f"c sin({_times(k, name)} + phase)", _waves(k * x))
    for k in range(1, _ABSOLUTE_HARMONICS + 1 if is_angle else 1):
        label = _times(k, name)
        yield Formula(f"c |sin({label})|", np.abs(np.sin(k * x))[:, None])
        yield Formula(f"c |cos({label})|", np.abs(np.cos(k * x))[:, None])
    extent = float(np.ptp(x)) or 1.0
    for width in _STEP_WIDTHS:
        text = f"c tanh({name} / {width * extent:.2g})"
        yield Formula(text, np.tanh((x - np.median(x)) / (width * extent))[:, None])


def _of_two(v: str, w: str, x: Array, y: Array) -> Iterator[Formula]:
    """Generate waves and smooth steps of sums, and products."""
    for a, b in _PAIR_FACTORS:
        total = a * x + b * y
        text = f"{_times(a, v)} {'+' if b > 0 else '-'} {_times(abs(b), w)}"
        yield Formula(f"c sin({text} + phase)", _waves(total))
        for width in _PAIR_STEP_WIDTHS:
            yield Formula(f"c tanh(({text}) / {width:g})", np.tanh(total / width)[:, None])
    yield Formula(f"c {v} {w}", (x * y)[:, None])
    for f, first in ((np.sin, "sin"), (np.cos, "cos")):
        for g, second in ((np.sin, "sin"), (np.cos, "cos")):
            yield Formula(f"c {first}({v}) {second}({w})", (f(x) * g(y))[:, None])


def _waves(phase: Array) -> Array:
    """Return cosine and sine (n, 2)."""
    return np.stack([np.cos(phase), np.sin(phase)], axis=1)


def _times(factor: float, name: str) -> str:
    return name if factor == 1 else f"{factor:g} {name}"
