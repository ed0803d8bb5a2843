"""A chart of ``cellapp.reporting.charts`` as inline SVG with its legend: the page draws what the terminal draws."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from cellapp.reporting.captioned import CaptionedFigure
from cellapp.reporting.charts import Array, Chart, Series
from cellapp.reporting.svg import (
    ARM_COLOUR,
    ARM_COLOURS,
    INK,
    SOFT,
    STAGE_COLOURS,
    draw_marks,
    drawing_settings,
    new_axes,
    set_log_axis,
    to_svg,
)
from cellapp.results import STAGES

_FEW = 60
"""Points up to which each is a marker; more are strokes of one path, a tenth of the text."""
_MANY = 1000
"""Points from which on strokes are thinner."""
_OWN_MARKERS = {"B": "s", "T": "^", "X": "X", "■": "s"}
"""Marks that stand for a thing rather than for an arm: base, tracker, next stop."""
_GUIDES = {"·": (":", "dotted"), ":": ("--", "dashed")}
"""Marks of lines that only guide the eye: how they are drawn, and what that is called."""
_HOLLOW = "○△□◇"


def chart_figure(key: str, chart: Chart) -> CaptionedFigure:
    """The chart with its message as a note; ids in the SVG begin with ``key``.

    Names are in the legend, never in the SVG: a person may have written them. Bars have numbers there.
    """
    if chart.categories:
        return CaptionedFigure(_bars(key, chart), chart.title, _bar_legend(chart), note=chart.message)
    with drawing_settings(key):
        figure, axes = new_axes()
        if chart.equal:
            axes.set_aspect("equal", adjustable="datalim")
        for one in chart.series:
            _draw(axes, one, _colour(chart, one))
        for limit in chart.limits:
            line = axes.axhline if limit.axis == "y" else axes.axvline
            line(limit.value, color=INK, linewidth=1.0, linestyle="--")
        axes.margins(0.06)
        axes.autoscale_view()
        _scale(axes.yaxis, chart.y.logarithmic, [*(one.y for one in chart.series), _limits(chart, "y")])
        _scale(axes.xaxis, chart.x.logarithmic, [*(one.x for one in chart.series), _limits(chart, "x")])
        axes.set_xlabel(chart.x.words)
        axes.set_ylabel(chart.y.words)
        svg = to_svg(figure, key)
    legend = tuple((_swatch(chart, one), _words(one)) for one in chart.series)
    limits = tuple(("floor", limit.name) for limit in chart.limits)
    return CaptionedFigure(svg, chart.title, (*legend, *limits), note=chart.message)


def _limits(chart: Chart, axis: str) -> Array:
    """The limits on a logarithmic axis, which has no margin to show them in; no others."""
    logarithmic = (chart.x if axis == "x" else chart.y).logarithmic
    return np.array([limit.value for limit in chart.limits if limit.axis == axis and logarithmic])


def _scale(axis: Any, logarithmic: bool, values: list[Array]) -> None:
    if logarithmic:
        shown = np.concatenate(values)
        set_log_axis(axis, shown[np.isfinite(shown) & (shown > 0.0)], None)
    elif all(np.all(one[np.isfinite(one)] % 1.0 == 0.0) for one in values):
        axis.set_major_locator(MaxNLocator(integer=True))


def _draw(axes: Any, one: Series, colour: str) -> None:
    if one.kind == "points" and len(one.x) > _FEW:
        draw_marks(axes, one.x, one.y, colour, "round", width=1.8 if len(one.x) > _MANY else 2.6)
    elif one.kind == "points":
        face = "none" if one.mark in _HOLLOW and one.mark else colour
        marker = _OWN_MARKERS.get(one.mark, "o")
        axes.plot(one.x, one.y, marker, color=colour, markersize=5.0, markerfacecolor=face)
    elif one.kind == "steps":
        axes.step(one.x, one.y, where="post", color=colour, linewidth=1.3)
    else:
        dashes = _GUIDES.get(one.mark, ("-", ""))[0]
        axes.plot(one.x, one.y, color=colour, linewidth=0.8 if one.mark in _GUIDES else 1.6, linestyle=dashes)


def _colour(chart: Chart, one: Series) -> str:
    """Colours of arms or stages; another one has that of the text or, where it only guides the eye, a soft one."""
    if one.style < ARM_COLOURS:
        return STAGE_COLOURS[STAGES[one.style]] if chart.by_stage else ARM_COLOUR[one.style]
    return SOFT if one.mark in _GUIDES else INK


def _swatch(chart: Chart, one: Series) -> str:
    if one.style >= ARM_COLOURS:
        return ""
    if chart.by_stage:
        return "before" if one.style == 0 else STAGES[one.style]
    return f"arm{one.style + 1}"


def _words(one: Series) -> str:
    """What a series is; its shape in words where it has no colour."""
    if one.style < ARM_COLOURS:
        return f"{one.name} (hollow)" if one.mark and one.mark in _HOLLOW and len(one.x) <= _FEW else one.name
    shape = {"B": "squares", "T": "triangle", "X": "crosses"}.get(one.mark)
    return f"{shape or _GUIDES.get(one.mark, ('', 'lines'))[1]}: {one.name}"


def _bars(key: str, chart: Chart) -> str:
    """Level bars, the first on top, each with its number."""
    with drawing_settings(key):
        figure, axes = new_axes()
        values = np.nan_to_num(chart.series[0].y) if chart.series else np.empty(0)
        rows = np.arange(1, len(values) + 1)
        axes.barh(rows, values, color=STAGE_COLOURS["geometry"], height=0.7)
        axes.set_ylim(len(values) + 0.6, 0.4)
        axes.set_yticks(rows)
        axes.set_xlabel(chart.y.words)
        return to_svg(figure, key)


def _bar_legend(chart: Chart) -> tuple[tuple[str, str], ...]:
    pairs = zip(chart.categories, chart.bar_texts, strict=True)
    return tuple(("", f"{number}: {name}, {text}") for number, (name, text) in enumerate(pairs, start=1))
