"""Axes of the page's charts: from values to pixels, and where the ticks are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.commands.view.charts import LEAST, Array, Axis
from cellapp.interfaces.render.log_ticks import log_ticks

_INTERVALS = 5.0
"""Intervals between the ticks of a linear axis to aim at."""
_ROOM = 0.05
"""Room at either end of a linear axis, as a share of its range."""
_LOG_ROOM = 1.25
"""Room at either end of a logarithmic axis, as a factor."""
_DEGREES = (5.0, 10.0, 15.0, 30.0, 45.0, 60.0, 90.0, 180.0)
_FEWEST_DEGREES = 20.0
"""Angles over a smaller range have decimal ticks."""
_MOST_TICKS = 6
"""Of a logarithmic axis."""


@dataclass(frozen=True)
class Scale:
    """An axis from ``low`` to ``high`` (their decadic logarithms where logarithmic) at ``begin`` to ``end`` [px]."""

    low: float
    high: float
    begin: float
    end: float
    logarithmic: bool = False
    degrees: bool = False
    whole: bool = False
    """Whether all values are integers, and so the ticks."""

    def at(self, values: Array) -> Array:
        """Pixels of values (n,); NaN stays NaN."""
        shown = np.log10(np.maximum(values, LEAST)) if self.logarithmic else values
        return np.asarray(self.begin + (shown - self.low) / (self.high - self.low) * (self.end - self.begin))

    def ticks(self) -> list[tuple[float, str]]:
        """Pixel and label of each tick."""
        low, high = (10.0**self.low, 10.0**self.high) if self.logarithmic else (self.low, self.high)
        values = log_ticks(low, high, _MOST_TICKS) if self.logarithmic else []
        values = values or self._linear_ticks(low, high)
        return [(float(self.at(np.array(value))), f"{value:.6g}") for value in values]

    def _linear_ticks(self, low: float, high: float) -> list[float]:
        step = self._step((high - low) / _INTERVALS)
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]

    def _step(self, wanted: float) -> float:
        if self.degrees and wanted * _INTERVALS > _FEWEST_DEGREES:
            return min(_DEGREES, key=lambda size: abs(math.log(size / wanted)))
        decade = 10.0 ** math.floor(math.log10(wanted))
        step = decade * min((1.0, 2.0, 5.0, 10.0), key=lambda size: abs(math.log(size * decade / wanted)))
        return max(round(step), 1.0) if self.whole else step


def scale_of(
    axis: Axis,
    values: Sequence[Array],
    begin: float,
    end: float,
    limits: tuple[float, float] | None = None,
    *,
    from_zero: bool = False,
) -> Scale:
    """The scale of an axis around all finite values, or from one of ``limits`` to the other.

    ``from_zero``: a lowest value of zero stands at the axis' end.
    """
    shown = np.concatenate([np.ravel(one) for one in values]) if values else np.empty(0)
    shown = np.where(np.abs(shown) < LEAST, 0.0, shown)
    shown = shown[np.isfinite(shown) & ((shown > 0.0) if axis.logarithmic else True)]
    if not len(shown):
        shown = np.array([1.0])
    whole, degrees = bool(np.all(shown % 1.0 == 0.0)), axis.unit in ("deg", "°")
    if axis.logarithmic:
        low, high = np.log10(shown.min() / _LOG_ROOM), np.log10(shown.max() * _LOG_ROOM)
        return Scale(float(low), float(high), begin, end, logarithmic=True)
    low, high = (float(shown.min()), float(shown.max())) if limits is None else limits
    room = 0.0 if limits is not None else _ROOM * (high - low) or max(0.5, _ROOM * abs(low))
    return Scale(low if from_zero and low == 0.0 else low - room, high + room, begin, end, degrees=degrees, whole=whole)


def equal_scales(x: Scale, y: Scale) -> tuple[Scale, Scale]:
    """Both scales with the coarser of their units, each around the middle of its range."""
    pixels = min(abs(one.end - one.begin) / (one.high - one.low) for one in (x, y))

    def widened(one: Scale) -> Scale:
        middle, half = 0.5 * (one.low + one.high), 0.5 * abs(one.end - one.begin) / pixels
        return Scale(middle - half, middle + half, one.begin, one.end)

    return widened(x), widened(y)
