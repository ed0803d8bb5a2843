"""CSV files with a million rows of numbers, as recordings of motion are; numpy reads them in a second or two.

Single cells are examined only if numpy refuses the file, to name line and column of what is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.csv_text import CsvFile, Problems, is_empty, is_number, short, stamp_seconds
from cellapp.ground.errors import InputError


@dataclass(frozen=True, eq=False)
class StreamTable:
    """The columns of a file in its order, each (n,); NaN is an empty cell.

    ``words`` holds the texts of columns that are not numbers: their values are indices into these. ``rows`` are the
    indices of the rows in the file.
    """

    path: Path
    columns: Mapping[str, NDArray[np.float64]]
    words: Mapping[str, tuple[str, ...]]
    rows: NDArray[np.intp]
    file: CsvFile | None = None
    dated: bool = False
    """Whether ``time_s`` is given as dates or times of day, which are converted to seconds."""

    def take(self, rows: NDArray[np.intp]) -> StreamTable:
        """Select some of the rows."""
        return replace(self, columns={name: its[rows] for name, its in self.columns.items()}, rows=self.rows[rows])

    def lines(self, rows: Collection[int]) -> dict[int, int]:
        """Return the line in the file of each of these rows."""
        wanted = {int(self.rows[row]): row for row in rows}
        body = self.file.rows() if wanted and self.file is not None else ()
        return {wanted[place]: line for place, (line, _) in enumerate(body) if place in wanted}


class _Codes(dict[str, int]):
    """Text -> code, numbered in the order in which texts occur."""

    def number(self, cell: str) -> int:
        """Return the code of a cell's text."""
        return self.setdefault(cell.strip(), len(self))


def read_stream_table(
    file: CsvFile, names: Sequence[str], *, numbers: Collection[str], required: Collection[str], texts: Collection[str]
) -> StreamTable:
    """Read a file whose columns ``numbers`` hold numbers, in every row if ``required``, and ``texts`` hold texts.

    ``names`` are those of its columns. Other columns hold numbers if all of their cells do, else texts. A column
    ``time_s`` may hold dates and times of day.

    Raises
    ------
    InputError
        Names file, line and column of a value that is not a number, missing, or given twice; if the file has no rows.
    """
    first = next(file.rows(), None)
    if first is None:
        raise InputError(
            f"{file.path}:{file.head}: there is a header row but no sample below it; expected a row per sample"
        )
    cells = dict(zip(names, first[1], strict=True))
    words = [n for n in names if n in texts or not (n in numbers or is_number(cells[n]))]
    stamps = ("time_s",) if "time_s" in cells and math.isfinite(stamp_seconds(cells["time_s"])) else ()
    numeric = [names.index(name) for name in numbers if name in names]
    try:
        table, codes = _load(file, names, words, (), stamps)
    except ValueError:
        table = None
    if table is None or not np.isfinite(table[:, numeric]).all():
        blank, other = _cell_by_cell(file, names, numbers, required, words, stamps)
        try:
            table, codes = _load(file, names, [*words, *other], blank, stamps)
        except ValueError as error:
            raise InputError(f"{file.path}: not CSV: {error}; correct the file") from None
    columns = dict(zip(names, table.T, strict=True))
    found = {name: (*code,) for name, code in codes.items()}
    return StreamTable(file.path, columns, found, np.arange(len(table)), file, dated=bool(stamps))


def _load(
    file: CsvFile, names: Sequence[str], words: Collection[str], blank: Collection[str], stamps: Collection[str]
) -> tuple[NDArray[np.float64], dict[str, _Codes]]:
    """Load all cells as numbers (n, columns), texts as codes; an empty cell of the ``blank`` columns is NaN."""
    codes = {name: _Codes() for name in words}
    converters: dict[int | str, Callable[[str], float]] = {names.index(name): _number_or_nan for name in blank}
    converters |= {names.index(name): code.number for name, code in codes.items()}
    converters |= {names.index(name): stamp_seconds for name in stamps}
    table = np.loadtxt(
        file.texts(),
        delimiter=None if file.separator == " " else file.separator,
        comments=None,
        quotechar='"',
        usecols=range(len(names)) if file.trailing else None,
        converters=converters or None,
        ndmin=2,
    )
    return np.asfortranarray(table), codes


def _number_or_nan(cell: str) -> float:
    return math.nan if is_empty(cell) else float(cell)


def _cell_by_cell(
    file: CsvFile,
    names: Sequence[str],
    numbers: Collection[str],
    required: Collection[str],
    words: Collection[str],
    stamps: Collection[str],
) -> tuple[set[str], set[str]]:
    """Find columns with empty cells, and unknown ones with texts. Raise ``InputError`` with the first wrong cell of
    each column of ``numbers``."""
    problems = Problems(lambda line: f"{file.path}:{line}")
    wrong: set[str] = set()
    blank: set[str] = set()
    texts: set[str] = set()
    looked_at = [(place, name) for place, name in enumerate(names) if name not in words]
    for line, row in file.rows():
        for place, name in looked_at:
            cell = "" if is_empty(row[place]) else row[place].strip()
            if not cell:
                blank.add(name)
            right = math.isfinite(stamp_seconds(cell)) if name in stamps else is_number(cell)
            if cell and not right and name not in numbers:
                texts.add(name)
            elif name not in wrong and not (right if cell else name not in required):
                wrong.add(name)
                what = "a date with its time, or a time of day," if name in stamps else "a finite number such as 0.25,"
                problems.add(line, name, f"expected {what} got '{short(cell)}'" if cell else "the value is missing")
    problems.check()
    return blank - texts, texts
