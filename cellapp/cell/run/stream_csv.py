"""CSV files with a million rows of numbers, as recordings of motion are; numpy reads them in a second or two.

Cells are looked at one by one only where numpy refuses the file: line and column of what is wrong are named then.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.csv_text import NUMBER, CsvTable, Problems, check_names, csv_rows, short
from cellapp.ground.errors import InputError

_ROW = "a row per sample"


@dataclass(frozen=True, eq=False)
class StreamTable:
    """The columns of a file in its order, each (n,); NaN is an empty cell.

    ``words`` has the texts of those columns that hold texts: their numbers are places in it. ``rows`` are the places of
    the rows in the file.
    """

    path: Path
    columns: Mapping[str, NDArray[np.float64]]
    words: Mapping[str, tuple[str, ...]]
    rows: NDArray[np.intp]

    def take(self, rows: NDArray[np.intp]) -> StreamTable:
        """These rows of it."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return StreamTable(self.path, columns, self.words, self.rows[rows])

    def lines(self, rows: Collection[int]) -> dict[int, int]:
        """Line in the file of each of these rows."""
        wanted = {int(self.rows[row]): row for row in rows}
        body = itertools.islice(csv_rows(self.path, "samples", _ROW), 1, None) if wanted else ()
        return {wanted[place]: line for place, (line, _) in enumerate(body) if place in wanted}


class _Codes(dict[str, int]):
    """Text -> its number, in the order in which texts come."""

    def number(self, cell: str) -> int:
        """The number of a cell's text."""
        return self.setdefault(cell.strip(), len(self))


def read_header(path: Path, what: str) -> tuple[str, ...]:
    """Names of the columns. Raises ``InputError`` if the file cannot be read, or a name is missing or there twice."""
    line, names = next(csv_rows(path, what, _ROW))
    problems = Problems(lambda _: f"{path}:{line}")
    check_names(CsvTable(path, tuple(names), (), {}), problems)
    problems.check()
    return tuple(names)


def read_stream_table(
    path: Path, what: str, *, numbers: Collection[str], required: Collection[str], texts: Collection[str]
) -> StreamTable:
    """Read a file of which columns ``numbers`` hold numbers, in every row if ``required``, and ``texts`` hold texts.

    Other columns hold numbers if all of their cells are, else texts.

    Raises
    ------
    InputError
        Names file, line and column of what is no number, missing, or given twice; if the file has no rows.
    """
    names = read_header(path, what)
    (head, _), *first = itertools.islice(csv_rows(path, what, _ROW), 2)
    if not first:
        raise InputError(f"{path}:{head}: there is a header row but no sample below it; expected {_ROW}")
    cells = dict(zip(names, first[0][1], strict=True))
    words = [n for n in names if n in texts or not (n in numbers or _is_number(cells[n]))]
    numeric = [names.index(name) for name in numbers if name in names]
    try:
        table, codes = _load(path, names, head, words, ())
    except ValueError:
        table = None
    if table is None or not np.isfinite(table[:, numeric]).all():
        blank, other = _cell_by_cell(path, names, numbers, required, words)
        try:
            table, codes = _load(path, names, head, [*words, *other], blank)
        except ValueError as error:
            raise InputError(f"{path}: not CSV: {error}; correct the file") from None
    columns = dict(zip(names, table.T, strict=True))
    return StreamTable(path, columns, {name: (*code,) for name, code in codes.items()}, np.arange(len(table)))


def _load(
    path: Path, names: Sequence[str], head: int, words: Collection[str], blank: Collection[str]
) -> tuple[NDArray[np.float64], dict[str, _Codes]]:
    """All cells as numbers (n, columns), of texts their codes; an empty cell of the ``blank`` columns is NaN."""
    codes = {name: _Codes() for name in words}
    converters: dict[int | str, Callable[[str], float]] = {names.index(name): _number_or_nan for name in blank}
    converters |= {names.index(name): code.number for name, code in codes.items()}
    table = np.loadtxt(
        path,
        delimiter=",",
        comments=None,
        quotechar='"',
        skiprows=head,
        converters=converters or None,
        encoding="utf-8-sig",
        ndmin=2,
    )
    return np.asfortranarray(table), codes


def _number_or_nan(cell: str) -> float:
    return float(cell) if cell.strip() else math.nan


def _is_number(cell: str) -> bool:
    text = cell.strip()
    return not text or (NUMBER.fullmatch(text) is not None and math.isfinite(float(text)))


def _cell_by_cell(
    path: Path, names: Sequence[str], numbers: Collection[str], required: Collection[str], words: Collection[str]
) -> tuple[set[str], set[str]]:
    """Columns with empty cells, and unknown ones with texts. Raises ``InputError`` with the first wrong cell of each
    column of ``numbers``."""
    problems = Problems(lambda line: f"{path}:{line}")
    wrong: set[str] = set()
    blank: set[str] = set()
    texts: set[str] = set()
    looked_at = [(place, name) for place, name in enumerate(names) if name not in words]
    for line, row in itertools.islice(csv_rows(path, "samples", _ROW), 1, None):
        for place, name in looked_at:
            cell = row[place].strip()
            if not cell:
                blank.add(name)
            if cell and not _is_number(cell) and name not in numbers:
                texts.add(name)
            elif name not in wrong and not (_is_number(cell) if cell else name not in required):
                wrong.add(name)
                expected = f"expected a finite number such as 0.25, got '{short(cell)}'"
                problems.add(line, name, expected if cell else "the value is missing")
    problems.check()
    return blank - texts, texts
