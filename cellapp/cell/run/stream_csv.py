"""CSV files with a million rows of numbers, as recordings of motion are; numpy reads them in a second or two.

Cells are looked at one by one only where numpy refuses the file: line and column of what is wrong are named then.
"""

from __future__ import annotations

import codecs
import itertools
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.csv_text import NUMBER, CsvTable, Problems, check_names, csv_rows, opened_text, short, split_row
from cellapp.cell.run.recorded_csv import COMMENTS, DECIMAL_COMMA
from cellapp.ground.errors import InputError

_ROW = "a row per sample"
_INDEX = "index"
"""Name of a first column without one: numbers of rows, as data frames are written."""
_LOOKED_AT_BYTES = 1_000_000
_LOOKED_AT = 80
"""Lines at the beginning of a file among which the names and the first numbers are."""
_UNIT_ALONE = re.compile(r"|-|\[[^\]]*\]|\([^)]*\)|s|ms|us|ns|deg|rad|mm?|(?:deg|rad)/s|A|Nm|°C?")
"""A cell of a row of units below the names."""
_EMPTY = ("", "nan", "null", "none", "na", "n/a", "-")
"""What programs write where there is no value."""


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
    file: StreamFile | None = None
    dated: bool = False
    """Whether ``time_s`` stands there as dates or times of day, which are in seconds."""

    def take(self, rows: NDArray[np.intp]) -> StreamTable:
        """These rows of it."""
        return replace(self, columns={name: its[rows] for name, its in self.columns.items()}, rows=self.rows[rows])

    def lines(self, rows: Collection[int]) -> dict[int, int]:
        """Line in the file of each of these rows."""
        wanted = {int(self.rows[row]): row for row in rows}
        body = self.file.rows() if wanted and self.file is not None else ()
        return {wanted[place]: line for place, (line, _) in enumerate(body) if place in wanted}


class _Codes(dict[str, int]):
    """Text -> its number, in the order in which texts come."""

    def number(self, cell: str) -> int:
        """The number of a cell's text."""
        return self.setdefault(cell.strip(), len(self))


@dataclass(frozen=True)
class StreamFile:
    """How a file is written: the line of its header, names as they stand there, sign between cells, decimal commas."""

    path: Path
    what: str
    head: int
    names: tuple[str, ...]
    separator: str = ","
    decimal_comma: bool = False
    trailing: bool = False
    """Whether each row ends with a separator."""
    encoding: str = "utf-8-sig"

    @property
    def plain(self) -> bool:
        """Whether it is plain CSV from its first line on."""
        return (self.separator, self.head, self.trailing, self.encoding) == (",", 1, False, "utf-8-sig")

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Line and cells of each row below the header; as ``csv_rows``, which raises the same."""
        if self.plain:
            yield from itertools.islice(csv_rows(self.path, self.what, _ROW), 1, None)
            return
        for line, text in self._numbered():
            cells = split_row(text, self.separator)
            if len(cells) != len(self.names) + self.trailing:
                raise InputError(
                    f"{self.path}:{line}: the row has {len(cells)} cells, the header has {len(self.names)}"
                )
            yield line, cells[: len(self.names)]

    def texts(self) -> Iterator[str]:
        """The rows below the header as numpy reads them."""
        for _, text in self._numbered():
            yield text

    def _numbered(self) -> Iterator[tuple[int, str]]:
        with opened_text(self.path, self.what, self.encoding) as file:
            for line, text in enumerate(file, start=1):
                kept = text.strip("\r\n")
                if line > self.head and kept.strip() and not kept.lstrip().startswith(COMMENTS):
                    yield line, kept.replace(",", ".") if self.decimal_comma else kept


def read_header(path: Path, what: str) -> StreamFile:
    """How a file of ``what`` is written. Raises ``InputError`` if it cannot be read, has no row of names, or a name is
    missing or there twice."""
    encoding = _encoding(path, what)
    with opened_text(path, what, encoding) as file:
        lines = [(n, line.strip("\r\n")) for n, line in enumerate(itertools.islice(file, _LOOKED_AT), start=1)]
        lines = [(n, line) for n, line in lines if line]
    found = _written(path, what, lines)
    if found is None:
        line, names = next(csv_rows(path, what, _ROW))
        found = StreamFile(path, what, line, tuple(names))
    found = replace(found, encoding=encoding)
    if len(found.names) > 2 and not found.names[0]:
        found = replace(found, names=(_INDEX, *found.names[1:]))
    problems = Problems(lambda _: f"{path}:{found.head}")
    check_names(CsvTable(path, found.names, (), {}), problems)
    problems.check()
    return found


def _encoding(path: Path, what: str) -> str:
    """UTF-8, or what programs of Windows write: UTF-16 with its mark, else Latin-1 where that gives text."""
    with opened_text(path, what, "latin-1") as file:
        begin = file.read(_LOOKED_AT_BYTES).encode("latin-1")
    if begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8-sig")().decode(begin)
    except UnicodeDecodeError:
        return "utf-8-sig" if b"\x00" in begin else "latin-1"
    return "utf-8-sig"


def _written(path: Path, what: str, lines: Sequence[tuple[int, str]]) -> StreamFile | None:
    """How the first row of numbers and the names above it are written; None for plain CSV, and where there are none."""
    for place, (line, text) in enumerate(lines):
        separator, comma = _separator(text)
        cells = split_row(text, separator)
        filled = [cell.replace(",", ".") if comma else cell for cell in cells if not _is_empty(cell)]
        texts = sum(not is_number(cell) for cell in filled)
        if text.lstrip().startswith(COMMENTS) or len(cells) < 2 or 2 * texts >= len(cells) or texts == len(filled):
            continue
        above = [(n, split_row(its.lstrip("#%/ "), separator)) for n, its in lines[:place]]
        above = [(n, row) for n, row in above if not any(math.isfinite(_seconds(cell)) for cell in row)]  # no names
        above = [(n, row) for n, row in above if len(row) == len(cells)] or above[-1:]
        if not above:
            raise InputError(
                f"{path}:{line}: there is no row of names above the first row of {len(cells)} numbers; write one, such"
                f" as {'time_s,q1,q2,q3' if 'joint' in what else 'time_s,x_m,y_m,z_m'}"
            )
        head, names = above[-1]
        if len(above) > 1 and all(_UNIT_ALONE.fullmatch(name) for name in names):
            names = [f"{name} {unit}".strip() for name, unit in zip(above[-2][1], names, strict=True)]
        trailing = len(names) > 2 and not names[-1] and not cells[-1]
        return StreamFile(path, what, head, tuple(names[: len(names) - trailing]), separator, comma, trailing)
    return None


def _separator(text: str) -> tuple[str, bool]:
    """The sign between the cells of a row of numbers, and whether they have decimal commas."""
    for sign in (";", "\t", "|"):
        if sign in text:
            return sign, "," in text
    blanks = text.split()
    if "," not in text:
        return " ", False
    if len(blanks) > 1 and all(DECIMAL_COMMA.fullmatch(cell) or is_number(cell) for cell in blanks):
        return " ", True
    return ",", False


def read_stream_table(
    file: StreamFile,
    names: Sequence[str],
    *,
    numbers: Collection[str],
    required: Collection[str],
    texts: Collection[str],
) -> StreamTable:
    """Read a file of which columns ``numbers`` hold numbers, in every row if ``required``, and ``texts`` hold texts.

    ``names`` are those of its columns. Other columns hold numbers if all of their cells are, else texts. A column
    ``time_s`` may hold dates and times of day.

    Raises
    ------
    InputError
        Names file, line and column of what is no number, missing, or given twice; if the file has no rows.
    """
    first = next(file.rows(), None)
    if first is None:
        raise InputError(f"{file.path}:{file.head}: there is a header row but no sample below it; expected {_ROW}")
    cells = dict(zip(names, first[1], strict=True))
    words = [n for n in names if n in texts or not (n in numbers or is_number(cells[n]))]
    stamps = ("time_s",) if "time_s" in cells and math.isfinite(_seconds(cells["time_s"])) else ()
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


def _seconds(cell: str) -> float:
    """A date with a time, or a time of day, as seconds since 1970 or midnight; NaN for other texts."""
    text = cell.strip()
    try:
        if re.match(r"\d{4}-", text):
            when = datetime.fromisoformat(text)
            return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
        if date := re.match(r"(\d{1,2})\.(\d{1,2})\.(\d{4})[ T]", text):
            return _seconds(f"{date[3]}-{date[2]:0>2}-{date[1]:0>2}T{text[date.end() :]}")
        day = re.fullmatch(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)", text)
        return math.nan if day is None else 3600.0 * int(day[1]) + 60.0 * int(day[2]) + float(day[3].replace(",", "."))
    except ValueError:
        return math.nan


def _load(
    file: StreamFile, names: Sequence[str], words: Collection[str], blank: Collection[str], stamps: Collection[str]
) -> tuple[NDArray[np.float64], dict[str, _Codes]]:
    """All cells as numbers (n, columns), of texts their codes; an empty cell of the ``blank`` columns is NaN."""
    codes = {name: _Codes() for name in words}
    converters: dict[int | str, Callable[[str], float]] = {names.index(name): _number_or_nan for name in blank}
    converters |= {names.index(name): code.number for name, code in codes.items()}
    converters |= {names.index(name): _seconds for name in stamps}
    table = np.loadtxt(
        file.path if file.plain else file.texts(),
        delimiter=None if file.separator == " " else file.separator,
        comments=None,
        quotechar='"',
        skiprows=file.head if file.plain else 0,
        usecols=range(len(names)) if file.trailing else None,
        converters=converters or None,
        encoding=file.encoding,
        ndmin=2,
    )
    return np.asfortranarray(table), codes


def _number_or_nan(cell: str) -> float:
    return math.nan if _is_empty(cell) else float(cell)


def _is_empty(cell: str) -> bool:
    """Whether a cell says that there is no value, as programs write it."""
    return cell.strip().lower() in _EMPTY


def is_number(cell: str) -> bool:
    """Whether a cell holds a finite number or nothing."""
    text = cell.strip()
    return not text or (NUMBER.fullmatch(text) is not None and math.isfinite(float(text)))


def _cell_by_cell(
    file: StreamFile,
    names: Sequence[str],
    numbers: Collection[str],
    required: Collection[str],
    words: Collection[str],
    stamps: Collection[str],
) -> tuple[set[str], set[str]]:
    """Columns with empty cells, and unknown ones with texts. Raises ``InputError`` with the first wrong cell of each
    column of ``numbers``."""
    problems = Problems(lambda line: f"{file.path}:{line}")
    wrong: set[str] = set()
    blank: set[str] = set()
    texts: set[str] = set()
    looked_at = [(place, name) for place, name in enumerate(names) if name not in words]
    for line, row in file.rows():
        for place, name in looked_at:
            cell = "" if _is_empty(row[place]) else row[place].strip()
            if not cell:
                blank.add(name)
            right = math.isfinite(_seconds(cell)) if name in stamps else is_number(cell)
            if cell and not right and name not in numbers:
                texts.add(name)
            elif name not in wrong and not (right if cell else name not in required):
                wrong.add(name)
                what = "a date with its time, or a time of day," if name in stamps else "a finite number such as 0.25,"
                problems.add(line, name, f"expected {what} got '{short(cell)}'" if cell else "the value is missing")
    problems.check()
    return blank - texts, texts
