"""Style of the series of a chart on the page: colours of its style sheet, dashes, shapes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellapp.commands.view.charts import LEAST, Array, Axis, Chart, Limit, Series
from cellapp.commands.view.words import METHOD_WORDS, STAGE_WORDS
from cellapp.ground.results import STAGES

Swatch = Literal["line", "dot", "dash", "round", "square", "triangle", "diamond", "cross", "bar", "limit"]
"""Appearance of a series in the legend: line (full, dotted, dashed), points of a shape, bars, a limit."""

ARM_COLOURS = 4
"""Number of arm colours in the style sheet; higher styles belong to no arm."""
MARKED = 40
"""Largest number of points that a line marks, unless it has a band."""
FEW = 60
"""Largest number of points that are drawn with the shape of their mark; more are dots."""
_STAGE_COLOURS = (*STAGES, "tracker-network")
_WORDS = dict([*METHOD_WORDS.items(), *STAGE_WORDS.items()])
_DASHES: Mapping[str, Swatch] = {"·": "dot", ":": "dash"}
"""Marks of lines that only guide the eye."""
_HOLLOW = "○△□◇"
_SHAPES: Mapping[str, Swatch] = {
    "B": "square",
    "■": "square",
    "□": "square",
    "T": "triangle",
    "△": "triangle",
    "▲": "triangle",
    "◇": "diamond",
    "◆": "diamond",
    "X": "cross",
    "×": "cross",
}


def css_colour(colour: str) -> str:
    """Return a colour of the style sheet; for ``ink`` the text colour."""
    return "currentColor" if colour == "ink" else f"var(--{colour})"


@dataclass(frozen=True)
class Look:
    """Colour (a variable of the style sheet, without dashes), swatch, and whether points are hollow."""

    colour: str
    swatch: Swatch
    hollow: bool = False

    @property
    def css_colour(self) -> str:
        """``currentColor`` or a variable of the style sheet."""
        return css_colour(self.colour)


@dataclass(frozen=True)
class LegendEntry:
    """One entry of a legend: the look of its swatch (None: no swatch), a text, and the series that it switches."""

    look: Look | None
    text: str
    series: tuple[int, ...] = ()


def look_of(chart: Chart, one: Series) -> Look:
    """Return the style of a series."""
    colours = _STAGE_COLOURS if chart.by_stage else tuple(f"arm{number + 1}" for number in range(ARM_COLOURS))
    guide = _DASHES.get(one.mark) if one.kind != "points" else None
    colour = colours[one.style] if one.style < len(colours) else "soft" if guide else "ink"
    if one.kind == "bars":
        return Look(colour, "bar")
    if one.kind != "points":
        return Look(colour, guide or "line")
    several = len(one.x) > FEW
    return Look(colour, _shape(one.mark, several=several), bool(one.mark) and one.mark in _HOLLOW and not several)


def _shape(mark: str, *, several: bool) -> Swatch:
    return "round" if several else _SHAPES.get(mark, "round")


def is_marked(one: Series) -> bool:
    """Return whether a line has a dot at each of its points."""
    return one.kind == "line" and one.band is None and not one.mark and len(one.x) <= MARKED


def series_words(chart: Chart, one: Series) -> str:
    """Return the name of a series for people; names of stages and of pair methods are translated to words."""
    return _WORDS.get(one.name, one.name) if chart.by_stage else one.name


def legend_of(chart: Chart) -> tuple[LegendEntry, ...]:
    """Return one entry for each series, and for each limit and band by name; none for bars, which are labelled."""
    if chart.categories:
        return ()
    entries = [
        LegendEntry(look_of(chart, one), series_words(chart, one), (number,)) for number, one in enumerate(chart.series)
    ]
    limits = dict.fromkeys(limit.name for limit in chart.limits)
    entries += [LegendEntry(Look("ink", "limit"), name) for name in limits]
    if any(one.band is not None for one in chart.series):
        entries.append(LegendEntry(None, "bands: 95 %"))
    return tuple(entries)


# -- A chart as compact JSON for the page's script, which redraws it with values under the pointer --------------------


_STEPS = 1e4
"""Resolution of an axis in steps: ten times the pixels of a wide screen."""
_DIGITS = 4
"""Significant digits on a logarithmic axis."""
Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]


def chart_data(chart: Chart) -> str:
    """Return the chart as JSON for a ``script`` element: no NaN, and no ``<`` that could end the element."""
    content: dict[str, Json] = {
        "kind": "chart",
        "title": chart.title,
        "x": _axis(chart.x),
        "y": _axis(chart.y),
        "series": [_series(chart, one) for one in chart.series],
        "limits": [_limit(limit) for limit in chart.limits],
    }
    if chart.equal:
        content["equal"] = True
    if chart.y_range is not None:
        content["range"] = [*chart.y_range]
    return script_json(content)


def script_json(content: Mapping[str, Json]) -> str:
    """Return JSON that is safe in a ``script`` element. Raises ``ValueError`` for NaN and infinity."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def rounded(values: Array, *, logarithmic: bool = False) -> list[Json]:
    """Round values (n,) to the digits that an axis around them shows; None for values that are not finite."""
    finite = np.isfinite(values)
    if logarithmic:
        return [_plain(float(f"{value:.{_DIGITS}g}")) if known else None for value, known in zip(values, finite)]
    span = float(np.ptp(values[finite])) if finite.any() else 0.0
    span = max(span or float(np.abs(values[finite]).max(initial=0.0)) or 1.0, LEAST)
    decimals = max(0, math.ceil(math.log10(_STEPS / span)))
    return [_plain(value) if math.isfinite(value) else None for value in np.round(values, decimals).tolist()]


def _plain(value: float) -> float | int:
    """Convert a whole number to an integer, which is written without a decimal point."""
    return int(value) if value.is_integer() and abs(value) < 1e15 else value


def _axis(axis: Axis) -> Json:
    return {"label": axis.label, "unit": axis.unit, "log": axis.logarithmic}


def _limit(limit: Limit) -> Json:
    return {"name": limit.name, "value": float(f"{limit.value:.6g}"), "axis": limit.axis}


def _series(chart: Chart, one: Series) -> Json:
    look = look_of(chart, one)
    content: dict[str, Json] = {
        "name": series_words(chart, one),
        "kind": one.kind,
        "colour": look.colour,
        "swatch": look.swatch,
        "x": rounded(one.x, logarithmic=chart.x.logarithmic),
        "y": rounded(one.y, logarithmic=chart.y.logarithmic),
    }
    if is_marked(one):
        content["marked"] = True
    if look.hollow:
        content["hollow"] = True
    if one.hints:
        content["hints"] = list(one.hints)
    if one.band is not None:
        content["band"] = rounded(one.band)
    return content
