"""From values to places along an axis: ranges, ticks and their texts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cellapp.commands.view.charts import Array, Axis
from cellapp.interfaces.render.log_ticks import log_ticks

_ROOM = 0.05
"""Room at either end of an axis, as a share of its range."""
_LARGEST = 1e100
"""Larger values are not drawn: sums and ratios of axes would overflow."""
_FAR = 10.0
"""Places beyond so many lengths of an axis are moved to there: a line that leaves the plot needs no more."""
_SAME = 1e-6
"""Values that differ by a smaller share are one value: the difference is rounding, and no tick could show it."""
_LONGEST = 7
"""Characters of a tick before its text changes to powers of ten."""
_PARTS_OF_A_TURN = (15.0, 30.0, 45.0, 60.0, 90.0, 180.0, 360.0)
"""Steps between ticks of an angle [deg]."""
_NEAR_ZERO = 0.5
"""Positive values begin at zero if the smallest is below this share of the largest: lengths compare better so."""


@dataclass(frozen=True)
class Scale:
    """A range of an axis along ``dots`` dots; a logarithmic one is positive. ``counted``: there are only integers."""

    axis: Axis
    low: float
    high: float
    dots: int
    counted: bool = False

    def place(self, values: Array) -> Array:
        """Positions in dots from ``low``; NaN where a logarithmic axis has no place for a value."""
        low, high, values = self.low, self.high, drawable(values)
        if self.axis.logarithmic:
            values = np.log10(np.where(values > 0.0, values, np.nan))
            low, high = math.log10(low), math.log10(high)
        return np.clip((values - low) / (high - low), -_FAR, _FAR) * (self.dots - 1)

    def ticks(self, most: int) -> list[float]:
        """At most about ``most`` round values in the range."""
        if self.axis.logarithmic and (ticks := log_ticks(self.low, self.high, most)):
            return ticks
        for wanted in (most, 2 * most):  # two ticks at least, so that they give a scale
            step = _round_step((self.high - self.low) / wanted, degrees=self.axis.unit == "deg")
            step = max(step, 1.0) if self.counted else step
            first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
            if last > first:
                break
        return [number * step for number in range(first, last + 1)]


def scale_of(axis: Axis, values: Array, dots: int, *, zero: bool = False) -> Scale:
    """A scale that shows all finite ``values``; with ``zero`` it contains zero."""
    values = drawable(values)
    shown = values[np.isfinite(values) & ((values > 0.0) | (not axis.logarithmic))]
    if len(shown) == 0:
        return Scale(axis, 0.1, 1.0, dots)
    low, high = float(shown.min()), float(shown.max())
    if axis.logarithmic:
        room = max((high / low) ** _ROOM, 1.1)
        return Scale(axis, max(low / room, 1.0 / _LARGEST), min(high * room, _LARGEST), dots)
    if zero or 0.0 <= low < _NEAR_ZERO * high:
        low, high = min(low, 0.0), max(high, 0.0)
    largest = max(abs(low), abs(high))
    room = _ROOM * (high - low) if high - low > _SAME * largest else 0.5 * largest or 0.5
    counted = not axis.unit and bool(np.all(shown == np.rint(shown)))
    return Scale(axis, low if low == 0.0 else low - room, high + room, dots, counted)


def drawable(values: Array) -> Array:
    """Values with NaN for those that no axis can hold, and zero for those next to it."""
    size = np.abs(values)
    return np.where(size <= _LARGEST, np.where(size < 1.0 / _LARGEST, 0.0, values), np.nan)


def equal_scales(x: Scale, y: Scale) -> tuple[Scale, Scale]:
    """The same length of a unit along both axes: the narrower range becomes wider. Dots are as high as wide."""
    unit = max((x.high - x.low) / (x.dots - 1), (y.high - y.low) / (y.dots - 1))
    return _widened(x, unit), _widened(y, unit)


def _widened(scale: Scale, unit: float) -> Scale:
    middle, half = 0.5 * (scale.low + scale.high), 0.5 * unit * (scale.dots - 1)
    return replace(scale, low=middle - half, high=middle + half)


def _round_step(least: float, *, degrees: bool) -> float:
    """The smallest of 1, 2, 5, 10, ... times a power of ten that is not below ``least``; of angles a part of a turn."""
    if degrees and 10.0 < least <= _PARTS_OF_A_TURN[-1]:
        return next(part for part in _PARTS_OF_A_TURN if part >= least)
    power = 10.0 ** math.floor(math.log10(least))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least * (1.0 - 1e-9))


def tick_texts(ticks: list[float], *, logarithmic: bool) -> list[str]:
    """Texts of ticks: as many decimals as the steps between them need."""
    if logarithmic or len(ticks) < 2:
        return [f"{tick:g}" for tick in ticks]
    decimals = max(0, -math.floor(math.log10(ticks[1] - ticks[0]) + 1e-9))
    texts = [f"{tick + 0.0:.{decimals}f}" for tick in ticks]
    return texts if max(map(len, texts)) <= _LONGEST else [f"{tick:g}" for tick in ticks]
