"""Charts of the handbook as small stand-alone SVG files, the same text on every machine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby
from typing import Literal

import numpy as np

from cellapp.robot.kinematics.transforms import Array

_WIDTH, _HEIGHT = 560.0, 320.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 66.0, 16.0, 34.0, 48.0
"""Room around the axes [px]: y labels, nothing, the legend, x labels."""
_TICKS = 5
"""Number of intervals between ticks to aim at."""
_ROUND = tuple(factor * 10.0**decade for decade in range(-3, 5) for factor in (1.0, 2.0, 5.0))
_DEGREES = (5.0, 10.0, 15.0, 30.0, 60.0, 90.0)
"""Steps between ticks."""
_STYLES = (("#0072b2", ""), ("#d55e00", "7 4"), ("#007a5a", "2 3"))
"""Colours that differ for colour-blind readers too (Okabe and Ito), and dashes for prints without colour."""
_LEGEND_STEP = 165.0


@dataclass(frozen=True)
class Series:
    """Values ``y`` (n,) over ``x`` (n,), as a line in the order given, NaN being a gap, or as points."""

    label: str
    x: Array
    y: Array
    kind: Literal["line", "points"] = "line"


@dataclass(frozen=True)
class Chart:
    """Up to three series over one variable; ``title`` says for people what is drawn.

    ``equal``: a map, in which one unit has the same length along both axes.
    """

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    equal: bool = False


def chart_svg(chart: Chart) -> str:
    """The chart as the text of an SVG file; coordinates are rounded to a tenth of a pixel."""
    degrees = chart.x_label.endswith("[deg]")
    x_axis = _Axis.of([one.x for one in chart.series], _LEFT, _WIDTH - _RIGHT, _DEGREES if degrees else _ROUND)
    zero = np.zeros(1)  # an effect is a deviation from nothing
    y_axis = _Axis.of([zero, *(one.y for one in chart.series)], _HEIGHT - _BOTTOM, _TOP, _ROUND)
    if chart.equal:
        x_axis, y_axis = _equal(x_axis, y_axis)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" role="img"'
        ' font-family="sans-serif" font-size="13">',
        f"<title>{escape(chart.title)}</title>",
        '<rect width="100%" height="100%" fill="#fff"/>',
        *_grid(x_axis, y_axis),
        _text(_WIDTH - _RIGHT, _HEIGHT - 10.0, chart.x_label, "end"),
        f'<text transform="translate(16 {_HEIGHT - _BOTTOM:.1f}) rotate(-90)">{escape(chart.y_label)}</text>',
    ]
    for number, one in enumerate(chart.series):
        colour, dashes = _STYLES[number % len(_STYLES)]
        parts += [_drawn(one, x_axis, y_axis, colour, dashes), *_legend(number, one, colour, dashes)]
    return "\n".join([*parts, "</svg>", ""])


@dataclass(frozen=True)
class _Axis:
    """A linear axis: values ``low`` to ``high`` at ``begin`` to ``end`` [px], ticks ``step`` apart."""

    low: float
    high: float
    step: float
    begin: float
    end: float

    @classmethod
    def of(cls, values: Sequence[Array], begin: float, end: float, steps: Sequence[float]) -> _Axis:
        """Around all values, with round ends; ``steps`` are the allowed steps."""
        low, high = min(float(np.nanmin(one)) for one in values), max(float(np.nanmax(one)) for one in values)
        wanted = (high - low) / _TICKS
        step = min(steps, key=lambda size: abs(math.log(size / wanted)))
        return cls(math.floor(low / step + 1e-9) * step, math.ceil(high / step - 1e-9) * step, step, begin, end)

    def at(self, values: Array) -> Array:
        """Pixels of values."""
        return np.asarray(self.begin + (values - self.low) / (self.high - self.low) * (self.end - self.begin))

    def ticks(self) -> list[tuple[float, str]]:
        """Pixel and label of each tick."""
        first, last = math.ceil(self.low / self.step - 1e-9), math.floor(self.high / self.step + 1e-9)
        values = [k * self.step for k in range(first, last + 1)]
        pixels = self.at(np.array(values)).tolist()
        return [(pixel, f"{round(value / self.step) * self.step:.6g}") for pixel, value in zip(pixels, values)]


def _equal(x_axis: _Axis, y_axis: _Axis) -> tuple[_Axis, _Axis]:
    """The axes with the coarser of both scales: the other one shows more about the middle of its range."""
    metre = min(abs(axis.end - axis.begin) / (axis.high - axis.low) for axis in (x_axis, y_axis))
    step = max(x_axis.step, y_axis.step)

    def widened(axis: _Axis) -> _Axis:
        middle, half = 0.5 * (axis.low + axis.high), 0.5 * abs(axis.end - axis.begin) / metre
        return _Axis(middle - half, middle + half, step, axis.begin, axis.end)

    return widened(x_axis), widened(y_axis)


def _grid(x_axis: _Axis, y_axis: _Axis) -> list[str]:
    left, right, bottom, top = x_axis.begin, x_axis.end, y_axis.begin, y_axis.end
    lines = [f"M{pixel:.1f} {bottom:.1f}V{top:.1f}" for pixel, _ in x_axis.ticks()]
    lines += [f"M{left:.1f} {pixel:.1f}H{right:.1f}" for pixel, _ in y_axis.ticks()]
    return [
        f'<path d="{"".join(lines)}" stroke="#ddd" fill="none"/>',
        *(_text(pixel, bottom + 18.0, label, "middle") for pixel, label in x_axis.ticks()),
        *(_text(left - 6.0, pixel + 4.0, label, "end") for pixel, label in y_axis.ticks()),
    ]


def _drawn(one: Series, x_axis: _Axis, y_axis: _Axis, colour: str, dashes: str) -> str:
    pixels = np.column_stack([x_axis.at(one.x), y_axis.at(one.y)]).tolist()
    if one.kind == "points":
        path = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in pixels)
        return f'<path d="{path}" stroke="{colour}" stroke-width="4" stroke-linecap="round" fill="none"/>'
    pieces = [list(piece) for seen, piece in groupby(pixels, key=lambda at: math.isfinite(at[0])) if seen]
    path = "".join("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in piece) for piece in pieces)
    return f'<path d="{path}" stroke="{colour}"{_dash(dashes)} stroke-width="2" fill="none"/>'


def _legend(number: int, one: Series, colour: str, dashes: str) -> list[str]:
    x = _LEFT + number * _LEGEND_STEP
    mark = f"M{x:.1f} 16h22" if one.kind == "line" else f"M{x + 11.0:.1f} 16h0"
    width = 2 if one.kind == "line" else 6
    cap = "" if one.kind == "line" else ' stroke-linecap="round"'
    dash = _dash(dashes if one.kind == "line" else "")
    return [f'<path d="{mark}" stroke="{colour}" stroke-width="{width}"{cap}{dash}/>', _text(x + 28.0, 20.0, one.label)]


def _dash(dashes: str) -> str:
    return f' stroke-dasharray="{dashes}"' if dashes else ""


def _text(x: float, y: float, text: str, anchor: str = "start") -> str:
    placed = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text x="{x:.1f}" y="{y:.1f}"{placed}>{escape(text)}</text>'
