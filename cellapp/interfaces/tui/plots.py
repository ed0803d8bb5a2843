"""A chart drawn into terminal cells, as characters and inks; the widget maps inks to colours."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cellapp.commands.view.charts import Array, Chart, Series
from cellapp.interfaces.render.chart import Scale, chart_scale, equal_scales

TEXT, HEADING, SOFT = -1, -2, -3
"""Inks that are not series: words and axes, title, limits."""
MARKS = "●▲■◆+×"
"""One mark for each style; further styles repeat them."""
LIMIT = "╌"
_BAND = "░"
_LEAST_ROWS, _LEAST_COLUMNS = 3, 16
"""Smallest data area [cells]: below it a plot says less than its message."""
_TICK_ROWS = 2
"""Rows per tick of the y axis."""
_TICK_COLUMNS = 7
"""Columns per tick of the x axis: a label of up to five characters and a gap."""
_MOST_TICKS = 8
"""Largest number of ticks of an axis, whatever its length: more give no more information."""
_MARK_EVERY = 10
"""Columns between two marks of a line: near enough to find them, far enough to see the line."""
_CELLS_A_MARK = 8
"""Cells per mark up to which every point of a cloud has its mark; in a denser cloud marks would hide each other."""
_MARKED_SHARE = 5
"""Of a dense cloud, every fifth cell shows its mark."""

Inked = tuple[str, int]
"""A text and its ink: the style of a series, or one of those above."""
InkedLine = list[Inked]


@dataclass(frozen=True, eq=False)
class Cells:
    """Characters and inks (rows, columns) of a drawing."""

    characters: NDArray[np.str_]
    inks: NDArray[np.int64]

    @classmethod
    def blank(cls, rows: int, columns: int) -> Cells:
        """Return blank cells."""
        return cls(np.full((rows, columns), " "), np.full((rows, columns), TEXT))

    def put(self, where: NDArray[np.bool_], characters: NDArray[np.str_] | str, ink: int) -> None:
        """Set characters where ``where`` (rows, columns) is true."""
        self.characters[where] = characters if isinstance(characters, str) else characters[where]
        self.inks[where] = ink

    def write(self, row: int, column: int, text: str, ink: int = TEXT) -> None:
        """Write a text that fits into a row."""
        self.characters[row, column : column + len(text)] = list(text)
        self.inks[row, column : column + len(text)] = ink

    def lines(self) -> Iterator[InkedLine]:
        """Yield the rows as runs of one ink."""
        for characters, inks in zip(self.characters, self.inks, strict=True):
            begin = [0, *(np.flatnonzero(np.diff(inks)) + 1).tolist()]
            text = "".join(characters.tolist())
            yield [(text[a:b], int(inks[a])) for a, b in pairwise([*begin, len(text)])]


def draw(chart: Chart, width: int, height: int) -> list[InkedLine]:
    """Draw title, plot, key and message in at most ``height`` lines of ``width`` cells.

    If the space is too small, parts are omitted in this order: the words of the axes, sentences after the first and the
    key, the plot. The message says as much as the plot.
    """
    if width < 1:
        return []
    title, message = _wrapped(chart.title, width, HEADING), _wrapped(chart.message, width)
    room = height - len(title)
    if not chart.is_empty:
        for above, below in _words(chart, width, message):
            plot = _plot(chart, width, room - len(above) - len(below))
            if plot is not None:
                return [*title, *above, *plot.lines(), *below]
    return title + message if len(message) <= room else message[:height]


def _words(chart: Chart, width: int, message: list[InkedLine]) -> Iterator[tuple[list[InkedLine], list[InkedLine]]]:
    """Yield lines above and below a plot: first all of them, then fewer and fewer."""
    axes, key = _wrapped(f"↑ {chart.y.words}   → {chart.x.words}", width), _key_lines(chart, width)
    sentence = _wrapped(chart.message.partition(". ")[0], width)
    yield axes, key + message
    yield [], key + message
    yield [], key + sentence
    yield [], message
    yield [], sentence


def _wrapped(text: str, width: int, ink: int = TEXT) -> list[InkedLine]:
    return [[(line, ink)] for line in textwrap.wrap(text, width)]


# -- axes -------------------------------------------------------------------------------------------------------------


def _plot(chart: Chart, width: int, height: int) -> Cells | None:
    """Return axes and data; None if the space is too small."""
    area = _area(chart, width, height)
    if area is None:
        return None
    margin, rows, columns = area
    x, y = _scales(chart, columns, rows)
    # the range of a map depends on its width: a label that became longer has no space
    labels = {row: text for row, text in _row_labels(y, rows).items() if len(text) < margin}
    cells = Cells.blank(height, width)
    for row in range(rows):
        text = labels.get(row)
        cells.write(row, 0, f"{text or '':>{margin - 1}}{'│' if text is None else '┤'}")
    cells.write(rows, margin - 1, "└" + "─" * columns)
    _write_column_labels(cells, x, margin)
    _draw_data(chart, Cells(cells.characters[:rows, margin:], cells.inks[:rows, margin:]), x, y)
    return cells


def _area(chart: Chart, width: int, height: int) -> tuple[int, int, int] | None:
    """Return the columns left of the data, and rows and columns of the data; None if the space is too small."""
    rows = height - 2  # the axis and its labels
    if rows < _LEAST_ROWS:
        return None
    margin = max((len(text) for text in _row_labels(_scales(chart, width, rows)[1], rows).values()), default=0) + 1
    return None if width - margin < _LEAST_COLUMNS else (margin, rows, width - margin)


def _scales(chart: Chart, columns: int, rows: int) -> tuple[Scale, Scale]:
    """Return scales of both axes in dots, for a plot of ``columns`` by ``rows`` cells."""
    x = chart_scale(chart, "x", 0.0, DOT_COLUMNS * columns - 1.0)
    y = chart_scale(chart, "y", 0.0, DOT_ROWS * rows - 1.0)
    return equal_scales(x, y) if chart.equal else (x, y)


def _row_labels(y: Scale, rows: int) -> dict[int, str]:
    """Return row -> text of its tick."""
    labels = y.labels(min(max(rows // _TICK_ROWS, 2), _MOST_TICKS))
    return {(DOT_ROWS * rows - 1 - round(at)) // DOT_ROWS: text for at, text in labels}


def _write_column_labels(cells: Cells, x: Scale, margin: int) -> None:
    """Write ticks of the x axis on the last two rows; omit a label that would touch the previous one."""
    columns = cells.characters.shape[1] - margin
    free = 0
    for at, text in x.labels(min(max(columns // _TICK_COLUMNS, 2), _MOST_TICKS)):
        column = margin + round(at) // DOT_COLUMNS
        begin = min(max(column - len(text) // 2, 0), margin + columns - len(text))
        if begin >= free:
            cells.write(-2, column, "┬")
            cells.write(-1, begin, text)
            free = begin + len(text) + 1


# -- data -------------------------------------------------------------------------------------------------------------


def _draw_data(chart: Chart, cells: Cells, x: Scale, y: Scale) -> None:
    for limit in chart.limits:
        at = round(float(y.place(np.array([limit.value]))[0]))
        if 0 <= at <= y.end:
            rows, _ = _places(*cells.characters.shape)
            line = rows == (round(y.end) - at) // DOT_ROWS
            cells.put(np.broadcast_to(line, cells.characters.shape), LIMIT, SOFT)
    for one in chart.series:
        _draw_band(one, cells, x, y)
    for one in chart.series:
        _draw_series(one, cells, x, y, several=len(chart.series) > 1)


def _places(rows: int, columns: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices of the rows (rows, 1) and of the columns (columns,)."""
    return np.arange(rows)[:, np.newaxis], np.arange(columns)


def _draw_band(one: Series, cells: Cells, x: Scale, y: Scale) -> None:
    """Shade the cells whose middle is between both edges of a band."""
    if one.band is None:
        return
    at = x.place(one.x) / DOT_COLUMNS
    low, high = ((y.end - y.place(edge)) / DOT_ROWS for edge in one.edges)
    seen = np.argsort(at)
    seen = seen[np.isfinite(at + low + high)[seen]]
    if len(seen) == 0:
        return
    rows, columns = _places(*cells.characters.shape)
    middle = columns + 0.5
    top, bottom = (np.interp(middle, at[seen], edge[seen], left=np.nan, right=np.nan) for edge in (high, low))
    cells.put((rows + 0.5 >= top) & (rows + 0.5 <= bottom), _BAND, one.style)


def _draw_series(one: Series, cells: Cells, x: Scale, y: Scale, *, several: bool) -> None:
    column, row = x.place(one.x), y.end - y.place(one.y)
    dots = no_dots(*cells.characters.shape)
    if one.kind == "line":
        set_line(dots, column, row)
    else:
        set_points(dots, column, row)
    occupied = occupied_cells(dots)
    cells.put(occupied, braille(dots), one.style)
    cells.put(_marked(one, occupied, column, row, several=several), mark_of(one), one.style)


def mark_of(one: Series) -> str:
    """Return the character that identifies a series without colour."""
    return one.mark or MARKS[one.style % len(MARKS)]


def _marked(one: Series, occupied: NDArray[np.bool_], column: Array, row: Array, *, several: bool) -> NDArray[np.bool_]:
    """Return a mask (rows, columns) of the cells with a series' mark: every point if there are few, else some cells."""
    rows, columns = _places(*occupied.shape)
    few = len(one.x) <= (occupied.size // _CELLS_A_MARK if one.kind == "points" else occupied.shape[1] // 4)
    if one.mark or few:
        at_points = no_dots(*occupied.shape)
        set_points(at_points, column, row)
        return occupied_cells(at_points)
    if not several:
        return np.zeros_like(occupied)
    if one.kind == "points":
        shares: NDArray[np.bool_] = (columns + 3 * rows) % _MARKED_SHARE == one.style % _MARKED_SHARE
        return occupied & shares
    topmost: NDArray[np.bool_] = np.cumsum(occupied, axis=0) == 1
    marked: NDArray[np.bool_] = columns % _MARK_EVERY == (2 + 3 * one.style) % _MARK_EVERY
    return occupied & topmost & marked


# -- words ------------------------------------------------------------------------------------------------------------


def _key_lines(chart: Chart, width: int) -> list[InkedLine]:
    """Return marks and names of the series and limits, if there are several."""
    entries = [(mark_of(one), one.name, one.style) for one in chart.series] if len(chart.series) > 1 else []
    for limit in chart.limits:
        entries.append((LIMIT, f"{limit.name} {limit.value:.3g} {chart.y.unit}".rstrip(), SOFT))
    entries += [(_BAND, "uncertainty", one.style) for one in chart.series if one.band is not None][:1]
    lines: list[InkedLine] = []
    used = width
    for mark, name, ink in entries:
        text = _cut(name, width - 2)
        if used + 4 + len(text) > width:
            lines.append([])
            used = -2
        lines[-1] += [("  " if lines[-1] else "", TEXT), (mark, ink), (f" {text}", TEXT)]
        used += 4 + len(text)
    return lines


def _cut(text: str, width: int) -> str:
    """Cut a text to a width, with an ellipsis if something is missing."""
    return text if len(text) <= width else f"{text[: max(width - 1, 0)]}…"


# -- Dots, lines and areas in braille characters: each terminal cell has 4 rows and 2 columns of dots -----------------


DOT_ROWS, DOT_COLUMNS = 4, 2
Dots = NDArray[np.bool_]
Characters = NDArray[np.str_]

_FIRST_BRAILLE = 0x2800
_WEIGHTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint32)
"""Bit of each dot of a braille character (Unicode, block U+2800)."""


def no_dots(rows: int, columns: int) -> Dots:
    """Return empty dots for ``rows`` and ``columns`` of cells."""
    return np.zeros((rows * DOT_ROWS, columns * DOT_COLUMNS), dtype=np.bool_)


def occupied_cells(dots: Dots) -> Dots:
    """Return a mask (rows, columns) of the cells that have dots."""
    rows, columns = dots.shape[0] // DOT_ROWS, dots.shape[1] // DOT_COLUMNS
    return np.asarray(dots.reshape(rows, DOT_ROWS, columns, DOT_COLUMNS).any(axis=(1, 3)))


def braille(dots: Dots) -> Characters:
    """Return the characters (rows, columns) that show the dots (4 rows, 2 columns) of each cell."""
    rows, columns = dots.shape[0] // DOT_ROWS, dots.shape[1] // DOT_COLUMNS
    cells = dots.reshape(rows, DOT_ROWS, columns, DOT_COLUMNS)
    codes = np.einsum("ijkl,jl->ik", cells, _WEIGHTS, dtype=np.uint32)
    return np.asarray((codes + np.uint32(_FIRST_BRAILLE)).view("<U1"))


def set_points(dots: Dots, column: Array, row: Array) -> None:
    """Set the dots at positions (n,) in dots; ignore those that are not finite or outside."""
    seen = np.isfinite(column) & np.isfinite(row)
    c, r = np.rint(column[seen]).astype(np.int64), np.rint(row[seen]).astype(np.int64)
    inside = (c >= 0) & (c < dots.shape[1]) & (r >= 0) & (r < dots.shape[0])
    dots[r[inside], c[inside]] = True


def set_line(dots: Dots, column: Array, row: Array) -> None:
    """Join positions (n,) in dots by straight lines; NaN is a gap."""
    set_points(dots, column, row)
    ends = np.isfinite(column) & np.isfinite(row)
    first = np.flatnonzero(ends[:-1] & ends[1:])
    across, down = np.diff(column)[first], np.diff(row)[first]
    count = np.ceil(np.maximum(np.abs(across), np.abs(down))).astype(np.int64) + 1
    segment = np.repeat(np.arange(len(first)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / count[segment]
    set_points(dots, column[first][segment] + share * across[segment], row[first][segment] + share * down[segment])
