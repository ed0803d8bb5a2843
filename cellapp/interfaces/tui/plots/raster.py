"""Dots, lines and areas in braille characters: each terminal cell has 4 rows and 2 columns of dots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellapp.commands.view.charts import Array

DOT_ROWS, DOT_COLUMNS = 4, 2
Dots = NDArray[np.bool_]
Characters = NDArray[np.str_]

_KEPT = 4
"""Number of points that are kept per column of dots."""
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
    column, row = thinned(column, row)
    set_points(dots, column, row)
    ends = np.isfinite(column) & np.isfinite(row)
    first = np.flatnonzero(ends[:-1] & ends[1:])
    across, down = np.diff(column)[first], np.diff(row)[first]
    count = np.ceil(np.maximum(np.abs(across), np.abs(down))).astype(np.int64) + 1
    segment = np.repeat(np.arange(len(first)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / count[segment]
    set_points(dots, column[first][segment] + share * across[segment], row[first][segment] + share * down[segment])


def thinned(column: Array, row: Array) -> tuple[Array, Array]:
    """Keep the first, lowest, highest and last of the positions in each column of dots: the line looks the same."""
    place = np.where(np.isfinite(column) & np.isfinite(row), np.rint(column), np.nan)
    new = ~((np.diff(place) == 0.0) | (np.isnan(place[1:]) & np.isnan(place[:-1])))
    begin = np.flatnonzero(np.append(True, new)) if len(column) else np.zeros(0, dtype=np.intp)
    if _KEPT * len(begin) >= len(column):
        return column, row
    end = np.append(begin[1:], len(column)) - 1
    low, high = np.minimum.reduceat(row, begin), np.maximum.reduceat(row, begin)
    return np.repeat(place[begin], _KEPT), np.column_stack([row[begin], low, high, row[end]]).ravel()


def set_bars(dots: Dots, column: Array, row: Array, zero: float) -> None:
    """Fill from the row ``zero`` to each row, over the range of columns nearest to each column (n,)."""
    seen = np.isfinite(column) & np.isfinite(row)
    column, row = column[seen], row[seen]
    if len(column) == 0:
        return
    every = np.arange(dots.shape[1])
    nearest = np.argmin(np.abs(every[:, np.newaxis] - column), axis=1)
    width = np.min(np.diff(np.unique(column)), initial=dots.shape[1])
    in_bar = np.abs(every - column[nearest]) <= 0.4 * width
    rows = np.arange(dots.shape[0])[:, np.newaxis]
    low, high = np.minimum(row, zero)[nearest], np.maximum(row, zero)[nearest]
    dots |= in_bar & (rows >= np.rint(low)) & (rows <= np.rint(high))


def as_steps(x: Array, y: Array) -> tuple[Array, Array]:
    """Return a line that holds each value up to the next x."""
    return np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
