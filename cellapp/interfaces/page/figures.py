"""A chart as inline SVG for the page: readable without a script and in print; names from users are escaped.

One path for each series: a few kilobytes and a millisecond per chart, where a plotting library takes fifty.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

import numpy as np

from cellapp.commands.view.charts import Array, Chart, Limit, Series
from cellapp.commands.view.table import Table
from cellapp.interfaces.render.chart import (
    DOT,
    FEW,
    Look,
    Scale,
    chart_scale,
    css_colour,
    equal_scales,
    is_marked,
    look_of,
)

_SVG_WIDTH, _HEIGHT = 400.0, 250.0
_TOP, _RIGHT, _BOTTOM = 8.0, 12.0, 36.0
_FONT = 9.5
_CHARACTER = 0.58
"""Mean width of a digit relative to the font size."""
_MARKS = '<text x="{x}" y="{y}" text-anchor="middle" stroke="none" fill="currentColor">{marks}</text>'
"""One element: each character begins at its own place."""
_HALF_A_MARK = 0.35 * _FONT
"""From the middle of a mark down to its base line."""
_MOST_TICKS = 6
"""Largest number of ticks of an axis."""
_MANY = 1000
"""Number of points above which dots are smaller."""


def chart_svg(chart: Chart) -> str:
    """Return the chart as an ``svg`` element with colours of the style sheet.

    Screen readers skip it: the figure's caption and message describe it.
    """
    x_axis, y_axis = _scales(chart)
    head = f'<svg viewBox="0 0 {_SVG_WIDTH:g} {_HEIGHT:g}" font-size="{_FONT}" aria-hidden="true" focusable="false"'
    frame, limits = _frame(chart, x_axis, y_axis), (_limit(limit, x_axis, y_axis) for limit in chart.limits)
    drawn = (_drawn(one, look_of(chart, one), x_axis, y_axis) for one in chart.series)
    return f'{head} fill="none" stroke="currentColor" stroke-width="1.4">{"".join((*frame, *drawn, *limits))}</svg>'


def in_colour(colour: str, body: str) -> str:
    """Return a group in one colour of the style sheet."""
    return f'<g style="color:{css_colour(colour)}">{body}</g>'


def text(x: float, y: float, words: str, anchor: str = "start", attributes: str = "") -> str:
    """Return a line of text in the colour of its group."""
    placed = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text x="{x:.1f}" y="{y:.1f}"{placed} stroke="none" fill="currentColor"{attributes}>{escape(words)}</text>'


def polyline(pixels: Array) -> str:
    """Return path data of points (n, 2) [px] joined by lines, with gaps at NaN."""
    finite = np.asarray(np.isfinite(pixels).all(axis=1))
    starts = finite & ~np.concatenate([[False], finite[:-1]])
    rows = zip(pixels[finite].tolist(), starts[finite].tolist(), strict=True)
    return "".join(f"{'M' if start else 'L'}{x:.1f} {y:.1f}" for (x, y), start in rows)


def dots(pixels: Array) -> str:
    """Return path data of points (n, 2) [px] as strokes of zero length, which round caps turn into dots."""
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in pixels[np.isfinite(pixels).all(axis=1)].tolist())


# -- axes -------------------------------------------------------------------------------------------------------------


def _scales(chart: Chart) -> tuple[Scale, Scale]:
    y_axis = chart_scale(chart, "y", _HEIGHT - _BOTTOM, _TOP)
    left = 27.0 + _FONT * _CHARACTER * max((len(label) for _, label in y_axis.labels(_MOST_TICKS)), default=1)
    x_axis = chart_scale(chart, "x", left, _SVG_WIDTH - _RIGHT)
    return equal_scales(x_axis, y_axis) if chart.equal else (x_axis, y_axis)


def _frame(chart: Chart, x_axis: Scale, y_axis: Scale) -> Iterator[str]:
    """Yield grid, tick labels and axis labels."""
    left, right, bottom, top = x_axis.begin, x_axis.end, y_axis.begin, y_axis.end
    x_ticks, y_ticks = x_axis.labels(_MOST_TICKS), y_axis.labels(_MOST_TICKS)
    lines = [f"M{pixel:.1f} {bottom:.1f}V{top:.1f}" for pixel, _ in x_ticks]
    lines += [f"M{left:.1f} {pixel:.1f}H{right:.1f}" for pixel, _ in y_ticks]
    yield in_colour("grid", f'<path d="{"".join(lines)}" stroke-width=".7"/>')
    yield in_colour("soft", f'<path d="M{left:.1f} {top:.1f}V{bottom:.1f}H{right:.1f}" stroke-width=".8"/>')
    yield from (text(pixel, bottom + 12.0, label, "middle") for pixel, label in x_ticks)
    yield from (text(left - 4.0, pixel + 3.3, label, "end") for pixel, label in y_ticks)
    yield text(0.5 * (left + right), bottom + 27.0, chart.x.words, "middle")
    middle = 0.5 * (top + bottom)
    yield text(10.0, middle, chart.y.words, "middle", f' transform="rotate(-90 10 {middle:.1f})"')


def _limit(limit: Limit, x_axis: Scale, y_axis: Scale) -> str:
    at = float(y_axis.place(np.array(limit.value)))
    line = f"M{x_axis.begin:.1f} {at:.1f}H{x_axis.end:.1f}"
    return f'<path d="{line}" stroke-dasharray="4 3" stroke-width="1"/>'


# -- series -----------------------------------------------------------------------------------------------------------


def _drawn(one: Series, look: Look, x_axis: Scale, y_axis: Scale) -> str:
    pixels = np.column_stack([x_axis.place(one.x), _within(y_axis.place(one.y), y_axis)])
    if one.kind == "points":
        return in_colour(look.colour, _points(pixels, look))
    band = "" if one.band is None else _band(one, x_axis, y_axis)
    dashes = {"dot": ' stroke-dasharray="1 3" stroke-width="1"', "dash": ' stroke-dasharray="4 3" stroke-width="1"'}
    path = f'<path d="{polyline(pixels)}" stroke-linejoin="round"{dashes.get(look.swatch, "")}/>'
    marks = f'<path d="{dots(pixels)}" stroke-linecap="round" stroke-width="4"/>' if is_marked(one) else ""
    return in_colour(look.colour, band + path + marks)


def _within(pixels: Array, y_axis: Scale) -> Array:
    """Replace positions outside the plot by NaN, so that values beyond the range are not drawn."""
    outside = (pixels < y_axis.end - 1.0) | (pixels > y_axis.begin + 1.0)
    return np.where(outside, np.nan, pixels)


def _band(one: Series, x_axis: Scale, y_axis: Scale) -> str:
    assert one.band is not None
    seen = np.isfinite(one.x + one.y + one.band)
    x = x_axis.place(one.x[seen])
    ends = np.clip(y_axis.place(np.stack(one.edges)[:, seen]), y_axis.end, y_axis.begin)
    around = np.vstack([np.column_stack([x, ends[0]]), np.column_stack([x, ends[1]])[::-1]])
    return f'<path d="{polyline(around)}" stroke="none" fill="currentColor" opacity=".22"/>'


def _points(pixels: Array, look: Look) -> str:
    if look.mark != DOT:
        seen = pixels[np.isfinite(pixels).all(axis=1)]
        x, y = (" ".join(f"{one:.1f}" for one in its) for its in (seen[:, 0], seen[:, 1] + _HALF_A_MARK))
        return _MARKS.format(x=x, y=y, marks=escape(look.mark) * len(seen))
    width = 5.0 if len(pixels) <= FEW else 3.0 if len(pixels) <= _MANY else 2.0
    return f'<path d="{dots(pixels)}" stroke-linecap="round" stroke-width="{width}"/>'


# -- Tables -----------------------------------------------------------------------------------------------------------


_HALF, _GAP, _SENTENCE = 60, 2, 30
"""Characters: of a table in half of a screen, between two columns, and of a line of a sentence in a cell."""


def is_wide(table: Table) -> bool:
    """Return whether the cells of a table need more than half of a screen."""
    rows = [table.headings, *table.text_rows()]
    longest = [max(max(map(len, word.split()), default=0) for word in column) for column in zip(*rows, strict=True)]
    texts = [min(max(map(len, column)), _SENTENCE) for column in zip(*table.text_rows(), strict=True)]
    return sum(map(max, longest, texts or longest)) + _GAP * len(longest) > _HALF
