"""A CSV file as text: cells by column with the line of each row, and a list of the errors in it."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs

WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
"""Pattern of a whole number; ``int`` would accept more (1_000, digits of other scripts)."""
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
"""Pattern of a decimal number; ``float`` would accept more (nan, 1_000)."""
COMMENTS = ("#", "%", "//")
"""Beginnings of lines that are comments."""
_SHOWN = 5
"""Problems per message: enough to see a pattern, few enough to read."""
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
    names: tuple[str, ...]
    lines: tuple[int, ...]
    cells: dict[str, tuple[str, ...]]
    row_places: tuple[str, ...] | None = None

    def place(self, line: int) -> str:
        """Return where a line is: "file:line", or the row of a table that is not a file."""
        if self.row_places is None:
            return f"{self.path}:{line}"
        return self.row_places[self.lines.index(line)] if line in self.lines else str(self.path)

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
            more = [f"and {len(texts) - _SHOWN} more"] if len(texts) > _SHOWN else []
            raise InputError("\n".join(texts[:_SHOWN] + more))


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


def table_text(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a table as CSV."""
    text = io.StringIO(newline="")
    # The writer quotes a carriage return within a text only if the line terminator contains one.
    writer = csv.writer(text, lineterminator="\r\n")
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
    (_, names), *rows = csv_rows(path, what, row)
    columns = zip(*(cells for _, cells in rows), strict=True) if rows else [()] * len(names)
    return CsvTable(path, tuple(names), tuple(line for line, _ in rows), dict(zip(names, columns, strict=True)))


def csv_rows(path: Path, what: str, row: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line and cells of each row of a UTF-8, comma-separated file, the header first; blank rows are skipped.

    Raises
    ------
    InputError
        If it cannot be read, is not CSV in UTF-8, is empty, or a row differs in length from the header.
    """
    with opened_text(path, what) as file:
        yield from _parse(path, file, row)


@contextmanager
def opened_text(path: Path, what: str, encoding: str = "utf-8-sig") -> Iterator[TextIO]:
    """Open a file of ``what`` as a context manager. Raise ``InputError`` if it cannot be read, or is not UTF-8."""
    try:
        with path.open(encoding=encoding, newline="") as file:
            yield file
    except FileNotFoundError:
        raise InputError(f"{path}: file not found; give a CSV file of {what}") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}; give a CSV file of {what}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text ({error.reason}); save the file as CSV in UTF-8") from None


def split_row(line: str, separator: str) -> list[str]:
    """Split a line of text into cells; a blank as separator stands for any number of them."""
    if separator == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def check_names(table: CsvTable, problems: Problems) -> None:
    """Note columns without a name, and names that are there twice."""
    for number, name in enumerate(table.names, start=1):
        if not name:
            problems.add(1, f"column {number}", "has no name; name it or remove it")
    for name in dict.fromkeys(name for name in table.names if name and table.names.count(name) > 1):
        problems.add(1, name, "the column is there twice; keep one")


def read_table_of(path: Path, what: str, one: str, row: str, columns: Sequence[str], optional: str = "") -> CsvTable:
    """Read a file that must have ``columns`` and at least one row; it may have the ``optional`` column.

    Messages name ``what`` it should hold, and the ``one`` thing that a ``row`` describes.

    Raises
    ------
    InputError
        As ``csv_rows``; for a column without a name, there twice or missing; if there is no row.
    """
    table = read_csv_table(path, what, row)
    problems = Problems(table.place)
    check_names(table, problems)
    expected = ", ".join(columns) + (f" and perhaps {optional}" if optional else "")
    for name in columns:
        if name not in table.names:
            problems.add(1, name, f"the column is missing; expected {expected}")
    problems.check()
    if not table.lines:
        raise InputError(f"{table.place(1)}: there is a header row but no {one}; expected {row}")
    return table


def _parse(path: Path, file: Iterable[str], expected: str) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(file, strict=True)
    names: list[str] | None = None
    line = 0
    try:
        for row in reader:
            line = reader.line_num
            if not any(row):
                continue
            if names is None:
                names = row = [name.strip() for name in row]
                if len(names) == 1 and re.search(r"[;\t|]", names[0]):
                    raise InputError(
                        f"{path}:{line}: the header is one column; separate columns by commas, and write 0.5, not 0,5"
                    )
            elif len(row) != len(names) and row[0].lstrip().startswith(COMMENTS):
                continue
            elif len(row) != len(names):
                column = names[len(row)] if len(row) < len(names) else f"column {len(names) + 1}"
                hint = "; write 0.5, not 0,5, and texts with commas in quotes" if len(row) > len(names) else ""
                raise InputError(
                    f"{path}:{line}: {column}: the row has {len(row)} cells, the header has {len(names)}{hint}"
                )
            yield line, row
    except csv.Error as error:
        raise InputError(f"{path}:{line + 1}: not CSV: {error}; correct the line") from None
    if names is None:
        raise InputError(f"{path} is empty; expected a header row and {expected}")
