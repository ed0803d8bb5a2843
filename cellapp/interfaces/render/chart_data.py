"""A chart as compact JSON for the page's script, which redraws it with values under the pointer."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

import numpy as np

from cellapp.commands.view.charts import LEAST, Array, Axis, Chart, Limit, Series
from cellapp.interfaces.render.chart_style import is_marked, look_of, series_words

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
