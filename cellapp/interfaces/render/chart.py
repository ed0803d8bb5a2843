"""Style of the series of a chart on the page: colours of its style sheet, dashes, shapes.

Axes of charts, the same on the page and in the terminal: ranges, positions along an axis, ticks and their labels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cellapp.commands.view.charts import LEAST, Array, Axis, Chart, Series
from cellapp.commands.view.words import METHOD_WORDS, STAGE_WORDS
from cellapp.ground.results import STAGES

Swatch = Literal["line", "dot", "dash", "point", "limit"]
"""Appearance of a series in the legend: line (full, dotted, dashed), points, a limit."""
DOT = "●"
"""Mark of points without one of their own, and of those that are too many to tell marks apart."""

ARM_COLOURS = 4
"""Number of arm colours in the style sheet; higher styles belong to no arm."""
MARKED = 40
"""Largest number of points that a line marks, unless it has a band."""
FEW = 60
"""Largest number of points that are drawn with their mark; more are dots."""
_STAGE_COLOURS = (*STAGES, "tracker-network")
_WORDS = dict([*METHOD_WORDS.items(), *STAGE_WORDS.items()])
_DASHES: Mapping[str, Swatch] = {"·": "dot", ":": "dash"}
"""Marks of lines that only guide the eye."""


def css_colour(colour: str) -> str:
    """Return a colour of the style sheet; for ``ink`` the text colour."""
    return "currentColor" if colour == "ink" else f"var(--{colour})"


@dataclass(frozen=True)
class Look:
    """Colour (a variable of the style sheet, without dashes), swatch, and the mark of points."""

    colour: str
    swatch: Swatch
    mark: str = DOT

    @property
    def css_colour(self) -> str:
        """``currentColor`` or a variable of the style sheet."""
        return css_colour(self.colour)


Legend = list[tuple[Look | None, str]]
"""Entries of a legend: the look of a swatch (None: no swatch) and a text."""


def look_of(chart: Chart, one: Series) -> Look:
    """Return the style of a series."""
    colours = _STAGE_COLOURS if chart.by_stage else tuple(f"arm{number + 1}" for number in range(ARM_COLOURS))
    guide = _DASHES.get(one.mark) if one.kind != "points" else None
    colour = colours[one.style] if one.style < len(colours) else "soft" if guide else "ink"
    if one.kind != "points":
        return Look(colour, guide or "line")
    return Look(colour, "point", one.mark if one.mark and len(one.x) <= FEW else DOT)


def is_marked(one: Series) -> bool:
    """Return whether a line has a dot at each of its points."""
    return one.kind == "line" and one.band is None and not one.mark and len(one.x) <= MARKED


def series_words(chart: Chart, one: Series) -> str:
    """Return the name of a series for people; names of stages and of pair methods are translated to words."""
    return _WORDS.get(one.name, one.name) if chart.by_stage else one.name


def legend_of(chart: Chart) -> Legend:
    """Return one entry for each series, and for each limit and band by name."""
    entries: Legend = [(look_of(chart, one), series_words(chart, one)) for one in chart.series]
    entries += [(Look("ink", "limit"), name) for name in dict.fromkeys(limit.name for limit in chart.limits)]
    bands = any(one.band is not None for one in chart.series)
    return [*entries, *([(None, "bands: 95 %")] if bands else [])]


_ROOM = 0.05
"""Margin at either end of an axis, as a share of its range."""
_LARGEST = 1.0 / LEAST
"""Limit of drawn values: with larger ones, sums and ratios of axes would overflow."""
_FAR = 10.0
"""Largest distance of a drawn position outside the range, in axis lengths; enough for a line that leaves the plot."""
_SAME = 1e-6
"""Relative difference below which values are equal: it is rounding, and no tick could show it."""
_LONGEST = 7
"""Longest label of a tick [characters]; longer ones change to powers of ten."""
_PARTS_OF_A_TURN = (15.0, 30.0, 45.0, 60.0, 90.0, 180.0, 360.0)
"""Steps between ticks of an angle [deg]."""
_NEAR_ZERO = 0.5
"""An axis begins at zero if the smallest value is positive and below this share of the largest: lengths compare
better."""


@dataclass(frozen=True)
class Scale:
    """A value range of an axis and its positions ``begin`` to ``end`` [dots or px]; a logarithmic range is positive.

    ``counted``: values and ticks are integers.
    """

    axis: Axis
    low: float
    high: float
    begin: float
    end: float
    counted: bool = False

    def place(self, values: Array) -> Array:
        """Return positions of values (n,); NaN for values that a logarithmic axis cannot show."""
        low, high, values = self.low, self.high, drawable(values)
        if self.axis.logarithmic:
            values = np.log10(np.where(values > 0.0, values, np.nan))
            low, high = math.log10(low), math.log10(high)
        return self.begin + np.clip((values - low) / (high - low), -_FAR, _FAR) * (self.end - self.begin)

    def ticks(self, most: int) -> list[float]:
        """Return at most about ``most`` round values in the range."""
        if self.axis.logarithmic and (ticks := log_ticks(self.low, self.high, most)):
            return ticks
        for wanted in (most, 2 * most):  # at least two ticks, so that they give a scale
            step = _round_step((self.high - self.low) / wanted, degrees=self.axis.unit == "deg")
            step = max(step, 1.0) if self.counted else step
            first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
            if last > first:
                break
        return [number * step for number in range(first, last + 1)]

    def labels(self, most: int) -> list[tuple[float, str]]:
        """Return position and label of each tick, with as many decimals as the tick step needs."""
        ticks = self.ticks(most)
        texts = [f"{tick:g}" for tick in ticks]
        if not self.axis.logarithmic and len(ticks) > 1:
            decimals = max(0, -math.floor(math.log10(ticks[1] - ticks[0]) + 1e-9))
            exact = [f"{tick + 0.0:.{decimals}f}" for tick in ticks]
            texts = exact if max(map(len, exact)) <= _LONGEST else texts
        return list(zip(self.place(np.array(ticks)).tolist(), texts, strict=True))


def chart_scale(chart: Chart, which: Literal["x", "y"], begin: float, end: float) -> Scale:
    """Return the scale of a chart's axis: it shows all series, bands and limits, or the range that the chart gives."""
    if which == "x":
        return scale_of(chart.x, np.concatenate([one.x for one in chart.series]), begin, end)
    shown = [edge for one in chart.series for edge in one.edges] if chart.y_range is None else [np.array(chart.y_range)]
    return scale_of(chart.y, np.array([*np.concatenate(shown), *(limit.value for limit in chart.limits)]), begin, end)


def scale_of(axis: Axis, values: Array, begin: float, end: float) -> Scale:
    """Return a scale that shows all finite ``values``."""
    values = drawable(values)
    shown = values[np.isfinite(values) & ((values > 0.0) | (not axis.logarithmic))]
    if len(shown) == 0:
        return Scale(axis, 0.1, 1.0, begin, end)
    low, high = float(shown.min()), float(shown.max())
    if axis.logarithmic:
        room = max((high / low) ** _ROOM, 1.1)
        return Scale(axis, max(low / room, LEAST), min(high * room, _LARGEST), begin, end)
    if 0.0 <= low < _NEAR_ZERO * high:
        low = 0.0
    largest = max(abs(low), abs(high))
    room = _ROOM * (high - low) if high - low > _SAME * largest else 0.5 * largest or 0.5
    counted = not axis.unit and bool(np.all(shown == np.rint(shown)))
    return Scale(axis, low if low == 0.0 else low - room, high + room, begin, end, counted)


def drawable(values: Array) -> Array:
    """Replace values too large for an axis by NaN, and values too close to zero by zero."""
    size = np.abs(values)
    return np.where(size <= _LARGEST, np.where(size < LEAST, 0.0, values), np.nan)


def equal_scales(x: Scale, y: Scale) -> tuple[Scale, Scale]:
    """Return scales with the same length of a unit along both axes: the narrower range becomes wider."""
    unit = max((one.high - one.low) / abs(one.end - one.begin) for one in (x, y))
    return _widened(x, unit), _widened(y, unit)


def _widened(scale: Scale, unit: float) -> Scale:
    middle, half = 0.5 * (scale.low + scale.high), 0.5 * unit * abs(scale.end - scale.begin)
    return replace(scale, low=middle - half, high=middle + half)


def _round_step(least: float, *, degrees: bool) -> float:
    """Return the smallest of 1, 2, 5, 10, ... times a power of ten from ``least`` on; for angles a part of a turn."""
    if degrees and 10.0 < least <= _PARTS_OF_A_TURN[-1]:
        return next(part for part in _PARTS_OF_A_TURN if part >= least)
    power = 10.0 ** math.floor(math.log10(least))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least * (1.0 - 1e-9))


# -- Ticks of logarithmic axes, the same on the page and in the terminal ----------------------------------------------


_MULTIPLES = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
"""Multiples of each decade that are ticks, from sparse to dense."""
_ENOUGH = 3
_SAME_LOG = 1e-12
"""Relative tolerance for a tick at an end of the axis."""


def log_ticks(low: float, high: float, most: int) -> list[float]:
    """Return at most ``most`` round values from ``low`` to ``high``, ascending; empty if the range has too few of them.

    Use the sparsest series with at least three values, if there is one: whole decades, else 1 and 3 of each, 1, 2 and
    5, and so on. Of many decades take every second or third one.
    """
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ends = low * (1.0 - _SAME_LOG), high * (1.0 + _SAME_LOG)
    options = [
        [tick for power in powers for factor in multiples if ends[0] <= (tick := float(f"{factor}e{power}")) <= ends[1]]
        for multiples in _MULTIPLES
    ]
    if len(options[0]) > most:
        return options[0][:: math.ceil(len(options[0]) / most)]
    fitting = [ticks for ticks in options if 2 <= len(ticks) <= most]
    fitting = fitting or [ticks[:: math.ceil(len(ticks) / most)] for ticks in options if len(ticks) > most][:1]
    return next((ticks for ticks in fitting if len(ticks) >= _ENOUGH), fitting[-1] if fitting else [])
