"""Format of a CSV file: header row, separator, decimal commas, comments, encoding.

Readings and recordings of other programs are read in the format that is detected here.
"""

from __future__ import annotations

import codecs
import itertools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from cellapp.cell.run.csv_text import (
    COMMENTS,
    NUMBER,
    CsvTable,
    Problems,
    check_names,
    csv_rows,
    opened_text,
    split_row,
)
from cellapp.ground.errors import InputError

_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
ROW = "rows of numbers"
_INDEX = "index"
"""Name of a first column without one: row numbers, as data frames are written."""
_LOOKED_AT_BYTES = 1_000_000
_LOOKED_AT = 80
"""Number of lines at the beginning of a file within which header and first numbers must be."""
_UNIT_ALONE = re.compile(r"|-|\[[^\]]*\]|\([^)]*\)|s|ms|us|ns|deg|rad|mm?|(?:deg|rad)/s|A|Nm|°C?")
"""A cell of a row of units below the header."""
_EMPTY = ("", "nan", "null", "none", "na", "n/a", "-")
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
    trailing: bool = False
    """Whether each row ends with a separator."""
    encoding: str = "utf-8-sig"

    @property
    def plain(self) -> bool:
        """Whether it is plain CSV from its first line on."""
        return (self.separator, self.head, self.trailing, self.encoding) == (",", 1, False, "utf-8-sig")

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line and cells of each row below the header. Raises as ``csv_rows``."""
        if self.plain:
            below = itertools.islice(csv_rows(self.path, self.what, ROW), 1, None)
            yield from ((line, row) for line, row in below if not row[0].lstrip().startswith(COMMENTS))
            return
        for line, text in self._numbered():
            cells = split_row(text, self.separator)
            if len(cells) != len(self.names) + self.trailing:
                raise InputError(
                    f"{self.path}:{line}: the row has {len(cells)} cells, the header has {len(self.names)}"
                )
            yield line, cells[: len(self.names)]

    def texts(self) -> Iterator[str]:
        """Yield the rows below the header as text for numpy."""
        for _, text in self._numbered():
            yield text

    def _numbered(self) -> Iterator[tuple[int, str]]:
        with opened_text(self.path, self.what, self.encoding) as file:
            for line, text in enumerate(file, start=1):
                kept = text.strip("\r\n")
                if line > self.head and kept.strip() and not kept.lstrip().startswith(COMMENTS):
                    yield line, kept.replace(",", ".") if self.decimal_comma else kept


def read_header(path: Path, what: str, example: str) -> CsvFile:
    """Detect the format of a file of ``what``; messages give an ``example`` of a header row.

    Raises
    ------
    InputError
        If it cannot be read, is not text, has no header row, or a name is missing or there twice.
    """
    encoding = _encoding(path, what)
    with opened_text(path, what, encoding) as file:
        lines = [(n, line.strip("\r\n")) for n, line in enumerate(itertools.islice(file, _LOOKED_AT), start=1)]
        lines = [(n, line) for n, line in lines if line]
    found = _written(path, what, lines, example)
    if found is None:
        line, names = next(csv_rows(path, what, ROW))
        found = CsvFile(path, what, line, tuple(names))
    found = replace(found, encoding=encoding)
    if len(found.names) > 2 and not found.names[0]:
        found = replace(found, names=(_INDEX, *found.names[1:]))
    problems = Problems(lambda _: f"{path}:{found.head}")
    check_names(CsvTable(path, found.names, (), {}), problems)
    problems.check()
    return found


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
        separator, comma = _separator(text)
        cells = split_row(text, separator)
        filled = [cell.replace(",", ".") if comma else cell for cell in cells if not is_empty(cell)]
        texts = sum(not is_number(cell) for cell in filled)
        if text.lstrip().startswith(COMMENTS) or len(cells) < 2 or 2 * texts >= len(cells) or texts == len(filled):
            continue
        above = [(n, split_row(its.lstrip("#%/ "), separator)) for n, its in lines[:place]]
        above = [
            (n, row) for n, row in above if not any(math.isfinite(stamp_seconds(cell)) for cell in row)
        ]  # a row with dates is no header
        above = [(n, row) for n, row in above if len(row) == len(cells)] or above[-1:]
        if not above:
            raise InputError(
                f"{path}:{line}: there is no row of names above the first row of {len(cells)} numbers; write one, such"
                f" as {example}"
            )
        head, names = above[-1]
        if len(above) > 1 and all(_UNIT_ALONE.fullmatch(name) for name in names):
            names = [f"{name} {unit}".strip() for name, unit in zip(above[-2][1], names, strict=True)]
        trailing = len(names) > 2 and not names[-1] and not cells[-1]
        return CsvFile(path, what, head, tuple(names[: len(names) - trailing]), separator, comma, trailing)
    return None


def _separator(text: str) -> tuple[str, bool]:
    """Detect the separator in a row of numbers, and whether these have decimal commas."""
    for sign in (";", "\t", "|"):
        if sign in text:
            return sign, "," in text
    blanks = text.split()
    if "," not in text:
        return " ", False
    if len(blanks) > 1 and all(_DECIMAL_COMMA.fullmatch(cell) or is_number(cell) for cell in blanks):
        return " ", True
    return ",", False


def stamp_seconds(cell: str) -> float:
    """Convert a date with time, or a time of day, to seconds since 1970 or midnight; NaN for other texts."""
    text = cell.strip()
    try:
        if re.match(r"\d{4}-", text):
            when = datetime.fromisoformat(text)
            return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
        if date := re.match(r"(\d{1,2})\.(\d{1,2})\.(\d{4})[ T]", text):
            return stamp_seconds(f"{date[3]}-{date[2]:0>2}-{date[1]:0>2}T{text[date.end() :]}")
        day = re.fullmatch(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)", text)
        return math.nan if day is None else 3600.0 * int(day[1]) + 60.0 * int(day[2]) + float(day[3].replace(",", "."))
    except ValueError:
        return math.nan


def is_empty(cell: str) -> bool:
    """Return whether a cell holds what programs write for a missing value."""
    return cell.strip().lower() in _EMPTY


def is_number(cell: str) -> bool:
    """Return whether a cell holds a finite number or nothing."""
    text = cell.strip()
    return not text or (NUMBER.fullmatch(text) is not None and math.isfinite(float(text)))
