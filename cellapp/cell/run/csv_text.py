"""A CSV file as text: cells by column with the line of each row, and a list of the errors in it.

Format of a CSV file: header row, separator, decimal commas, comments, encoding.

Readings and recordings of other programs are read in the format that is detected here.

Data frames as the table of cells that a CSV file of the same values gives: numbers become their shortest exact texts,
so that they are checked as those of a file.
"""

from __future__ import annotations

import codecs
import csv
import io
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeGuard

from cellapp.estimation.readings.columns import CONFIGURATION
from cellapp.ground.counting import first_few
from cellapp.ground.errors import InputError
from cellapp.ground.file_text import readable
from cellapp.ground.outputs import NEW_ONLY, Outputs

if TYPE_CHECKING:
    import pandas as pd


WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
"""Pattern of a whole number; ``int`` would accept more (1_000, digits of other scripts)."""
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
"""Pattern of a decimal number; ``float`` would accept more (nan, 1_000)."""
COMMENTS = ("#", "%", "//")
"""Beginnings of lines that are comments."""
_LONGEST_SHOWN = 40
"""Number of characters of a wrong cell that a message shows."""
_FORMULA = ("=", "+", "-", "@")
"""Characters with which a formula begins in spreadsheets."""


@dataclass(frozen=True)
class CsvTable:
    """The cells of a file by column; ``lines`` are the numbers of the lines in which the rows end.

    ``row_places`` say where each row is if the table is not a file: "the data frame, row 7".
    """

    path: Path
    lines: tuple[int, ...]
    cells: dict[str, tuple[str, ...]]
    row_places: tuple[str, ...] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the columns, in order."""
        return tuple(self.cells)

    def place(self, line: int) -> str:
        """Return where a line is: "file:line", or the row of a table that is not a file."""
        if self.row_places is None:
            return f"{self.path}:{line}"
        return self.row_places[self.lines.index(line)] if line in self.lines else str(self.path)

    def take(self, rows: Sequence[int]) -> CsvTable:
        """Select some of the rows."""
        cells = {name: tuple(its[row] for row in rows) for name, its in self.cells.items()}
        places = None if self.row_places is None else tuple(self.row_places[row] for row in rows)
        return replace(self, lines=tuple(self.lines[row] for row in rows), cells=cells, row_places=places)

    def row_words(self, line: int) -> str:
        """Return the reference to a line in a sentence about another line of the same table."""
        return f"line {line}" if self.row_places is None else self.place(line)


@dataclass
class Problems:
    """Problems of one file, reported together in the order of lines, so that they can be corrected in one go.

    ``place`` returns the location of a line.
    """

    place: Callable[[int], str]
    found: dict[tuple[int, str], str] = field(default_factory=dict)
    count: int = 0

    def add(self, line: int, column: str, text: str) -> None:
        """Note a problem; of several at one cell only the first is kept (a column that both arms lack)."""
        self.count += 1
        self.found.setdefault((line, column), f"{self.place(line)}: {column}: {text}")

    def check(self) -> None:
        """Raise ``InputError`` with the first problems if there are any."""
        if self.found:
            texts = [self.found[where] for where in sorted(self.found, key=lambda where: where[0])]
            raise InputError("\n".join(first_few(texts, "and {} more")))


def short(text: str, longest: int = _LONGEST_SHOWN) -> str:
    """Shorten a wrong cell, or another text of a file, for a message."""
    return text if len(text) <= longest else text[: longest - 3] + "..."


def quoted_text(text: str) -> str:
    """Prefix a text with an apostrophe if spreadsheets would take it for a formula (= + - @); numbers stay."""
    return f"'{text}" if text.lstrip("'").startswith(_FORMULA) and not NUMBER.fullmatch(text) else text


def unquoted_text(text: str) -> str:
    """Return what ``quoted_text`` was given."""
    return text[1:] if text.startswith("'") and text.lstrip("'").startswith(_FORMULA) else text


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[str]], outputs: Outputs = NEW_ONLY) -> None:
    """Write a file completely or not at all.

    Raises
    ------
    InputError
        If it cannot or must not be written.
    """
    outputs.write_text(path, table_text(header, rows))


def table_text(header: Sequence[str], rows: Iterable[Sequence[str]], end: str = "\r\n") -> str:
    """Format a table as CSV, with this ``end`` of each line."""
    text = io.StringIO(newline="")
    # The writer quotes a carriage return within a text only if the line terminator contains one.
    writer = csv.writer(text, lineterminator=end)
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def read_csv_table(path: Path, what: str = "readings", row: str = "a row per arm per stop") -> CsvTable:
    """Read a UTF-8, comma-separated file; blank rows are skipped.

    Messages name ``what`` it should hold and what a ``row`` is.

    Raises
    ------
    InputError
        As ``csv_rows``.
    """
    (head, names), *rows = csv_rows(path, what, row)
    check_names(names, f"{path}:{head}")
    columns = zip(*(cells for _, cells in rows), strict=True) if rows else [()] * len(names)
    return CsvTable(path, tuple(line for line, _ in rows), dict(zip(names, columns, strict=True)))


def csv_rows(path: Path, what: str, row: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line and cells of each row of a UTF-8, comma-separated file, the header first; blank rows are skipped.

    Raises
    ------
    InputError
        If it cannot be read, is not CSV in UTF-8, is empty, or a row differs in length from the header.
    """
    with opened_text(path, what) as file:
        reader = csv.reader(file, strict=True)
        numbered = ((reader.line_num, cells) for cells in reader)
        line = 0
        try:
            line, header = next((one for one in numbered if any(one[1])), (0, list[str]()))
            names = _named([name.strip() for name in header])
            if not header:
                raise InputError(f"{path} is empty; expected a header row and {row}")
            if len(names) == 1 and re.search(r"[;\t|]", names[0]):
                raise InputError(
                    f"{path}:{line}: the header is one column; separate columns by commas, and write 0.5, not 0,5"
                )
            yield line, names
            for line, cells in numbered:
                if any(cells) and (len(cells) == len(names) or not cells[0].lstrip().startswith(COMMENTS)):
                    yield line, _as_wide(f"{path}:{line}", cells, names, len(header))
        except csv.Error as error:
            raise InputError(f"{path}:{line + 1}: not CSV: {error}; correct the line") from None


def _as_wide(place: str, cells: list[str], names: Sequence[str], columns: int, commas: bool = True) -> list[str]:
    """Return the cells of a row below ``names`` of the first ``columns``. Raise ``InputError`` if it is not as wide."""
    count = len(cells)
    unnamed = [number for number, cell in enumerate(cells, start=1) if number > len(names) and cell]
    if count == columns and unnamed:
        raise InputError(f"{place}: column {unnamed[0]}: has no name; name it or remove it")
    if count not in (len(names), columns):
        column = names[count] if count < len(names) else f"column {len(names) + 1}"
        hint = "; write 0.5, not 0,5, and texts with commas in quotes" if count > len(names) and commas else ""
        raise InputError(f"{place}: {column}: the row has {count} cells, the header has {len(names)}{hint}")
    return cells[: len(names)]


@contextmanager
def opened_text(path: Path, what: str, encoding: str = "utf-8-sig") -> Iterator[TextIO]:
    """Open a file of ``what`` as a context manager. Raise ``InputError`` if it cannot be read, or is not UTF-8."""
    try:
        with readable(path, f"give a CSV file of {what}"), path.open(encoding=encoding, newline="") as file:
            yield file
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text ({error.reason}); save the file as CSV in UTF-8") from None


def split_row(line: str, separator: str) -> list[str]:
    """Split a line of text into cells; a blank as separator stands for any number of them."""
    if separator == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def check_names(names: Sequence[str], place: str) -> None:
    """Raise ``InputError`` for columns without a name, and for names that are there twice."""
    problems = Problems(lambda _: place)
    for number, name in enumerate(names, start=1):
        if not name:
            problems.add(number, f"column {number}", "has no name; name it or remove it")
        elif name in names[: number - 1]:
            problems.add(number, name, "the column is there twice; keep one")
    problems.check()


def _named(names: Sequence[str]) -> list[str]:
    """Leave out the last columns without a name, as spreadsheets write them."""
    return [name for place, name in enumerate(names) if any(names[place:])]


_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
ROW = "rows of numbers"
_INDEX = "index"
"""Name of a first column without one: row numbers, as data frames are written."""
_LOOKED_AT_BYTES = 1_000_000
_LOOKED_AT = 80
"""Number of lines at the beginning of a file within which header and first numbers must be."""
_UNIT_ALONE = re.compile(
    r"|-|\[[^\]]*\]|\([^)]*\)|s|ms|us|ns|deg|rad|mm?|cm|in|(?:deg|rad)/s|A|Nm|°C?"
    r"|degrees?|radians?|(?:milli)?met(?:er|re)s?|inch(?:es)?|seconds?",
    re.IGNORECASE,
)
"""A cell of a row of units below the header."""
_AXES = re.compile(r"AXES\s*=\s*CARTESIAN:?\s*X,\s*Y,\s*Z\s*\((\w+)\)", re.IGNORECASE)
"""Comment of a SpatialAnalyzer export, which has no row of names."""
_MINUS = "\N{MINUS SIGN}"
_FIGURES = re.compile(rf"[+{_MINUS}-]?(?:[0-9][0-9.,'’]*|[.,][0-9]+)(?:[eE][+-]?[0-9]+|[dD][+-][0-9]+)?")
"""A number in any country's form, or Fortran's."""
_THOUSANDS = {sign: re.compile(rf"[+{_MINUS}-]?[0-9]{{1,3}}(?:{re.escape(sign)}[0-9]{{3}})+") for sign in ",.'’"}
_NO_TABLES = {
    "a program of an ABB controller (RAPID)": r"^\s*MODULE\b|:=\s*\[\[",
    "a program of a KUKA controller (KRL)": r"\bE6(?:AXIS|POS)\b|^&ACCESS|\{\s*A1\s",
    "a program of a Fanuc controller (LS)": r"^/PROG\b|^\s*J1\s*=",
    "a job of a Yaskawa controller (INFORM)": r"^/JOB\b|^//POS\b",
    "JSON": r"^[\s\[{]*\"\w+\"\s*:",
    "YAML": r"^-?\s*\w+:\s*\[\s*[-\d.]",
}
"""What people give for a table, by a line of it."""
_DATED = re.compile(r"(\d{1,2})([./])(\d{1,2})\2(\d{4}|\d\d)[ T]+")
"""Day, month and year; with slashes the month comes first, where it can be one."""
_OF_DAY = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)(?: ?([aApP][mM]))?")
_EMPTY = ("", "nan", "null", "none", "na", "n/a", "#n/a", "-", "--", "---")
"""Texts that programs write for a missing value."""


@dataclass(frozen=True)
class CsvFile:
    """Format of a file: line of its header, names as they stand there, separator, decimal commas."""

    path: Path
    what: str
    head: int
    names: tuple[str, ...]
    separator: str = ","
    decimal_comma: bool = False
    trailing: int = 0
    """Number of empty columns without a name at the end of each row."""
    encoding: str = "utf-8-sig"
    thousands: str = ""
    """Sign between the thousands of its numbers."""

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line and cells of each row below the header, which may be repeated. Raises as ``csv_rows``."""
        rows = ((line, split_row(text, self.separator)) for line, text in self._numbered())
        if self == CsvFile(self.path, self.what, 1, self.names):  # plain CSV: a text in quotes may have several lines
            below = itertools.islice(csv_rows(self.path, self.what, ROW), 1, None)
            rows = ((line, cells) for line, cells in below if not cells[0].lstrip().startswith(COMMENTS))
        for line, cells in rows:
            if cells[0].strip() == self.names[0] and tuple(map(str.strip, cells)) == self.names:
                continue
            kept = cells if any(cells[len(self.names) :]) else cells[: len(self.names)]
            wide = _as_wide(f"{self.path}:{line}", kept, self.names, len(self.names), self.separator == ",")
            yield line, [plain_number(cell, self.decimal_comma, self.thousands) for cell in wide]

    def texts(self) -> Iterator[str]:
        """Yield the rows below the header as text for numpy."""
        for _, text in self._numbered():
            if self.thousands or (self.decimal_comma and self.separator == ","):
                cells = (
                    plain_number(one, self.decimal_comma, self.thousands) for one in split_row(text, self.separator)
                )
                yield self.separator.join(f'"{one}"' if self.separator in one else one for one in cells)
            else:
                yield (text.replace(",", ".") if self.decimal_comma else text).replace(_MINUS, "-") + "\n"

    def _numbered(self) -> Iterator[tuple[int, str]]:
        head, quoted = "", False
        with opened_text(self.path, self.what, self.encoding) as file:
            for line, text in enumerate(file, start=1):
                kept = text.strip("\r\n")
                head = kept if line == self.head else head
                comment = not quoted and kept.lstrip().startswith(COMMENTS)
                if line > self.head and kept.strip(f" \t{self.separator}") and kept != head and not comment:
                    yield line, kept
                    quoted ^= kept.count('"') % 2 == 1


def read_header(path: Path, what: str, example: str) -> CsvFile:
    """Detect the format of a file of ``what``; messages give an ``example`` of a header row.

    Raises
    ------
    InputError
        If it cannot be read, is not text or a program, has no header row, or a name is missing. One that is there
        again gets its number: ``X (2)``.
    """
    encoding = _encoding(path, what)
    with opened_text(path, what, encoding) as file:
        lines = [(n, line.strip("\r\n")) for n, line in enumerate(itertools.islice(file, _LOOKED_AT), start=1)]
        lines = [(n, line) for n, line in lines if line]
    for its_kind, pattern in _NO_TABLES.items():
        if line := next((n for n, text in lines if re.search(pattern, text)), 0):
            raise InputError(
                f"{path}:{line}: {its_kind}, no table of {what}: write a row for each position, below a row of names"
                f" such as {example}"
            )
    found = _written(path, what, lines, example)
    if found is None:
        line, header = next(csv_rows(path, what, ROW))
        found = CsvFile(path, what, line, tuple(header))
    names = [*found.names]
    if len(names) > 2 and not names[0]:
        names[0] = _INDEX
    count = [names[: place + 1].count(name) for place, name in enumerate(names)]
    names = [f"{name} ({n})" if name and n > 1 else name for name, n in zip(names, count, strict=True)]
    check_names(names, f"{path}:{found.head}")
    return replace(found, names=tuple(names), encoding=encoding)


def _encoding(path: Path, what: str) -> str:
    """Detect the encoding: UTF-8, UTF-16 with its mark, or Latin-1 (both from Windows) where that gives text."""
    with opened_text(path, what, "latin-1") as file:
        begin = file.read(_LOOKED_AT_BYTES).encode("latin-1")
    if begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    encoding = "utf-8-sig"
    try:
        codecs.getincrementaldecoder("utf-8-sig")().decode(begin)
    except UnicodeDecodeError:
        encoding = "latin-1"
    if b"\x00" in begin:
        raise InputError(f"{path}: not a text file; export the table as CSV")
    return encoding


def _written(path: Path, what: str, lines: Sequence[tuple[int, str]], example: str) -> CsvFile | None:
    """Detect the format of the first row of numbers and the header above it; None for plain CSV or without numbers."""
    for place, (line, text) in enumerate(lines):
        separator = _separator(text)
        cells = split_row(text, separator)
        filled = [cell for cell in cells if not is_empty(cell)]
        texts = sum(not _FIGURES.fullmatch(cell) for cell in filled)
        if text.lstrip().startswith(COMMENTS) or len(cells) < 2 or 2 * texts >= len(cells) or texts == len(filled):
            continue
        above = [(n, split_row(its.lstrip("#%/ "), separator)) for n, its in lines[:place]]
        above = [
            (n, row) for n, row in above if not any(math.isfinite(stamp_seconds(cell)) for cell in row)
        ]  # a row with dates is no header
        axes = [match[1] for _, its in lines[:place] if (match := _AXES.search(its))]
        above = [(n, row) for n, row in above if len(row) == len(cells)] or ([] if axes else above[-1:])
        comma, thousands = _number_form(cell for _, its in lines[place:] for cell in split_row(its, separator))
        if not above and axes and (names := _measured_points(cells, axes[-1])):
            return CsvFile(path, what, line - 1, names, separator, comma)
        if not above:
            raise InputError(
                f"{path}:{line}: there is no row of names above the first row of {len(cells)} numbers; write one, such"
                f" as {example}"
            )
        head, row = above[-1]
        if len(above) > 1 and all(_UNIT_ALONE.fullmatch(name) for name in row) and any(row):
            row = [f"{name} {unit}".strip() for name, unit in zip(above[-2][1], row, strict=True)]
        kept = _named(row)
        trailing = (len(row) if any(cells[len(row) :]) else max(len(row), len(cells))) - len(kept)
        return CsvFile(path, what, head, tuple(kept), separator, comma, trailing, thousands=thousands)
    return None


def _number_form(cells: Iterable[str]) -> tuple[bool, str]:
    """Return whether numbers have decimal commas, and the sign between their thousands, by all of these cells."""
    figures = [cell for cell in cells if _FIGURES.fullmatch(cell)]
    commas, points = [one for one in figures if "," in one], [one for one in figures if NUMBER.fullmatch(one)]
    points = [one for one in points if "." in one]
    if apostrophe := next((sign for sign in "'’" for one in figures if sign in one), ""):
        return bool(commas), apostrophe
    if both := next((one for one in commas if "." in one), ""):
        comma = both.rfind(",") > both.rfind(".")
        return comma, "." if comma else ","
    grouped = {sign: all(map(_THOUSANDS[sign].fullmatch, its)) for sign, its in ((",", commas), (".", points))}
    if commas and points and grouped[","] != grouped["."]:
        return grouped["."], "." if grouped["."] else ","
    return bool(commas), ""


def plain_number(cell: str, decimal_comma: bool = False, thousands: str = "") -> str:
    """Return a number in the form that ``NUMBER`` describes; any other text as it is."""
    if not _FIGURES.fullmatch(cell) or (not decimal_comma and NUMBER.fullmatch(cell)):
        return cell
    if thousands and (thousands in "'’" or _THOUSANDS[thousands].match(cell)):
        cell = cell.replace(thousands, "")
    cell = cell.replace(",", ".") if decimal_comma else cell
    return cell.replace(_MINUS, "-").replace("D", "E").replace("d", "e")


def _measured_points(cells: Sequence[str], unit: str) -> tuple[str, ...]:
    """Return names for a row of a SpatialAnalyzer export: names of the point, X, Y, Z, time; empty if it is none."""
    whole = "".join("d" if NUMBER.fullmatch(cell) and "." in cell else "t" if ":" in cell else "n" for cell in cells)
    match = re.fullmatch(r"(n*)ddd(t?)(.*)", whole)
    if match is None:
        return ()
    before = [f"name {place}" for place in range(1, len(match[1]) + 1)]
    after = [f"column {place}" for place in range(1, len(match[3]) + 1)]
    return (*before, *(f"{axis} [{unit}]" for axis in "XYZ"), *(["time"] * len(match[2])), *after)


def _separator(text: str) -> str:
    """Detect the separator in a row of numbers."""
    for sign in (";", "\t", "|"):
        if sign in text:
            return sign
    blanks = text.split()
    decimal_commas = len(blanks) > 1 and all(_DECIMAL_COMMA.fullmatch(cell) or is_number(cell) for cell in blanks)
    return "," if "," in text and not decimal_commas else " "


def stamp_seconds(cell: str) -> float:
    """Convert a date with time, or a time of day, to seconds since 1970 or midnight; NaN for other texts."""
    text = cell.strip().lstrip("'")  # spreadsheets mark a text so
    try:
        if re.match(r"\d{4}-", text):
            when = datetime.fromisoformat(text)
            return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
        if date := _DATED.match(text):
            day, month = (date[3], date[1]) if date[2] == "/" and int(date[1]) <= 12 else (date[1], date[3])
            year = date[4] if len(date[4]) == 4 else f"20{date[4]}"
            return stamp_seconds(f"{year}-{month:0>2}-{day:0>2}") + stamp_seconds(text[date.end() :])
        time = _OF_DAY.fullmatch(text)
        if time is None:
            return math.nan
        hour = int(time[1]) if time[4] is None else int(time[1]) % 12 + 12 * (time[4].lower() == "pm")
        return 3600.0 * hour + 60.0 * int(time[2]) + float(time[3].replace(",", "."))
    except ValueError:
        return math.nan


def is_empty(cell: str) -> bool:
    """Return whether a cell holds what programs write for a missing value."""
    return cell.strip().lower() in _EMPTY


def is_number(cell: str) -> bool:
    """Return whether a cell holds a finite number or nothing."""
    text = cell.strip()
    return not text or (NUMBER.fullmatch(text) is not None and math.isfinite(float(text)))


def is_frame(value: object) -> TypeGuard[pd.DataFrame]:
    """Return whether a value is a data frame of pandas, which need not be installed."""
    return type(value).__name__ == "DataFrame" and hasattr(value, "columns")


def table_of_frame(frame: pd.DataFrame) -> CsvTable:
    """Convert a data frame with the column names of a CSV file; missing values (None, NaN, NA) become empty cells.

    Messages name rows by the index of the frame.
    """
    names = [str(name) for name in frame.columns]
    check_names(names, "data frame")
    columns = [column.astype(object).where(column.notna(), None).tolist() for _, column in frame.items()]
    cells = {
        name: tuple("" if one is None else str(one) for one in (whole(its) if name == CONFIGURATION.name else its))
        for name, its in zip(names, columns, strict=True)
    }
    return table_in_memory("data frame", cells, [f"data frame, row {label}" for label in frame.index.tolist()])


def table_in_memory(name: str, cells: dict[str, tuple[str, ...]], places: Sequence[str]) -> CsvTable:
    """Return cells by column as a table; ``places`` say where each row is. Line 1 is the header, as in a file."""
    return CsvTable(Path(name), tuple(range(2, len(places) + 2)), cells, tuple(places))


def whole(values: Sequence[Any]) -> list[Any]:
    """Return numbers of stops, with whole ones that are stored as floats as integers."""
    return [int(one) if isinstance(one, float) and one.is_integer() else one for one in values]
