"""A view as an HTML fragment for a notebook: tables, and preformatted lines.

Charts drawn with matplotlib, which is optional: the extra ``plot`` installs it.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from html import escape
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from cellapp.commands.view.charts import Chart, Series
from cellapp.commands.view.parts import Parts, printed
from cellapp.commands.view.table import Table
from cellapp.interfaces.render.chart import series_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def html_view(view: Parts) -> str:
    """Return tables and lines in their order as one ``div``, with all content escaped."""
    parts = []
    for are_lines, group in groupby(printed(view), lambda part: isinstance(part, str)):
        members = list(group)
        if are_lines:
            lines = "\n".join(str(line) for line in members).strip("\n")
            parts.append(f"<pre>{escape(lines)}</pre>")
        else:
            parts += [_table(table) for table in members if isinstance(table, Table)]
    return f"<div>{''.join(parts)}</div>"


def _table(table: Table) -> str:
    sides = ["right" if column.is_number else "left" for column in table.columns]
    head = _row("th", table.headings, sides)
    rows = "".join(_row("td", row, sides) for row in table.text_rows())
    return f"<table><caption>{escape(table.title)}</caption><thead>{head}</thead><tbody>{rows}</tbody></table>"


def _row(tag: str, cells: tuple[str, ...], sides: list[str]) -> str:
    inside = (
        f'<{tag} style="text-align: {side}">{escape(cell)}</{tag}>' for cell, side in zip(cells, sides, strict=True)
    )
    return f"<tr>{''.join(inside)}</tr>"


_COLUMNS = 2
"""Number of charts side by side in a figure."""
_SIZE = (6.0, 3.8)
"""Width and height of a chart [inch]."""
_TITLE = 60
"""Longest line of the title [characters]."""


def draw_charts(charts: Sequence[Chart]) -> Figure:
    """Draw every chart on axes of its own; return the figure. It opens no window: a notebook shows the figure.

    Raises
    ------
    ImportError
        If matplotlib is not installed; the message says how to install it.
    """
    try:
        from matplotlib.figure import Figure  # optional; its import takes half a second
    except ImportError as error:
        raise ImportError("plots need matplotlib; install it with: pip install 'cellapp[plot]'") from error
    columns = min(_COLUMNS, len(charts))
    rows = math.ceil(len(charts) / columns)
    figure = Figure(figsize=(_SIZE[0] * columns, _SIZE[1] * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for chart, one in zip(charts, axes, strict=False):
        draw_chart(chart, one)
    for unused in axes[len(charts) :]:
        unused.remove()
    return figure


def draw_chart(chart: Chart, axes: Axes) -> None:
    """Draw a chart on axes: a bar for each category, or else its series, with its limits."""
    axes.set_title(textwrap.fill(chart.title, _TITLE), fontsize="medium")
    if chart.categories:
        places = np.arange(len(chart.categories))
        bars = axes.barh(places, np.nan_to_num(chart.series[0].y), tick_label=chart.categories)
        axes.bar_label(bars, labels=chart.bar_texts, padding=3)
        axes.invert_yaxis()
        axes.margins(x=0.2)
        axes.set_xlabel(chart.y.words)
        return
    for one in chart.series:
        _draw_series(chart, one, axes)
    for limit in chart.limits:
        line = axes.axhline if limit.axis == "y" else axes.axvline
        line(limit.value, color="black", linestyle="--", linewidth=1.0, label=limit.name)
    for axis, set_scale, set_label in (
        (chart.x, axes.set_xscale, axes.set_xlabel),
        (chart.y, axes.set_yscale, axes.set_ylabel),
    ):
        set_scale("log" if axis.logarithmic else "linear")
        set_label(axis.words)
    if chart.y_range is not None:
        axes.set_ylim(*chart.y_range)
    if chart.equal:
        axes.set_aspect("equal")
    if chart.series:
        axes.legend(fontsize="small")
    else:
        axes.text(0.5, 0.5, chart.message, transform=axes.transAxes, ha="center", wrap=True)


def _draw_series(chart: Chart, one: Series, axes: Axes) -> None:
    colour, name = f"C{one.style}", series_words(chart, one)
    if one.kind == "points":
        axes.plot(one.x, one.y, ".", color=colour, label=name)
    elif one.kind == "steps":
        axes.step(one.x, one.y, where="post", color=colour, label=name)
    elif one.kind == "bars":
        axes.bar(one.x, one.y, color=colour, label=name)
    else:
        axes.plot(one.x, one.y, color=colour, label=name)
    if one.band is not None:
        axes.fill_between(one.x, one.y - one.band, one.y + one.band, color=colour, alpha=0.25, linewidth=0.0)
