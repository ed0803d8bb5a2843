"""Tables as typed data, and the one formatter that converts their cells to text.

Terminal, TUI, HTML and Markdown draw the same ``Table``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, TypeAlias, TypeVar

R = TypeVar("R")

MOST_ROWS = 60
"""Most rows that are shown of a table that may have thousands; the JSON and the run file have all."""


@dataclass(frozen=True)
class Number:
    """A number with its own decimals and unit, for rows that differ from their column."""

    value: float
    decimals: int
    unit: str = ""


@dataclass(frozen=True)
class Interval:
    """Limits of an interval; ``decimals`` replaces the column's number format."""

    low: float
    high: float
    decimals: int | None = None


Cell = str | int | float | Number | Interval | None
"""Contents of a cell; None is an empty cell."""


@dataclass(frozen=True)
class Column:
    """A column of text, or with a ``number_format`` such as ``.4f`` of numbers and intervals, aligned right."""

    title: str
    number_format: str | None = None
    unit: str = ""

    @property
    def heading(self) -> str:
        """Title with the unit in brackets."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def is_number(self) -> bool:
        """Whether cells are aligned right."""
        return self.number_format is not None


@dataclass(frozen=True)
class Table:
    """A titled table; the cells of the first column name the rows.

    Raises
    ------
    ValueError
        If a row does not have one cell for each column.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"{self.title}: {len(row)} cells in a row of {len(self.columns)} columns")

    @property
    def headings(self) -> tuple[str, ...]:
        """Column headings with units."""
        return tuple(column.heading for column in self.columns)

    def with_texts(self, change: Callable[[str], str]) -> Table:
        """Return the table with ``change`` made to the text of its cells."""
        rows = tuple(tuple(change(cell) if isinstance(cell, str) else cell for cell in row) for row in self.rows)
        return replace(self, rows=rows)

    def text_rows(self) -> tuple[tuple[str, ...], ...]:
        """Return all cells as text."""
        return tuple(
            tuple(format_cell(cell, column.number_format or "") for cell, column in zip(row, self.columns, strict=True))
            for row in self.rows
        )

    def shown_and_exact(self) -> tuple[tuple[tuple[str, str], ...], ...]:
        """Return all cells as text, each with its number in full precision; empty if the text is already exact."""
        return tuple(
            tuple((text, exact_cell(cell, text)) for cell, text in zip(row, texts, strict=True))
            for row, texts in zip(self.rows, self.text_rows(), strict=True)
        )


Source: TypeAlias = str | Callable[[Any], Cell]
"""Source of a cell: the name of a row's attribute, or a function of the row."""
Field: TypeAlias = tuple[str, Source] | tuple[str, Source, str] | tuple[str, Source, str, str]
"""A column: heading, source of its cells, and for numbers their format and unit. Shares are shown in %."""


def table_of(title: str, rows: Iterable[Any], *fields: Field) -> Table:
    """Build a table with a row for each object."""
    columns = tuple(Column(one[0], *one[2:]) for one in fields)
    sources = [attrgetter(one[1]) if isinstance(one[1], str) else one[1] for one in fields]
    cells = tuple(
        tuple(_shown(source(row), column.unit) for column, source in zip(columns, sources, strict=True)) for row in rows
    )
    return Table(title, columns, cells)


def table_of_cells(title: str, rows: Iterable[Sequence[Cell]], *headings: str | tuple[str, ...]) -> Table:
    """Build a table of rows of cells; columns of text by their title, of numbers by title, format and, if any, unit."""
    columns = tuple(Column(one) if isinstance(one, str) else Column(*one) for one in headings)
    return Table(title, columns, tuple(map(tuple, rows)))


def with_rows(*tables: Table) -> list[Table]:
    """Return the tables that have rows."""
    return [table for table in tables if table.rows]


def _shown(value: Any, unit: str) -> Any:
    return 100.0 * value if unit == "%" and isinstance(value, float) else value


def urgent_rows(
    title: str,
    rows: Sequence[R],
    *fields: Field,
    urgency: Callable[[R], float] = lambda row: 0.0,
    numbered: bool = False,
) -> list[Table]:
    """Show at most ``MOST_ROWS`` rows, those with the largest urgency in their order; without columns that are empty.

    No table without rows. If ``numbered``, the first column has the places of the rows among all, from 1.
    """
    chosen = sorted(sorted(range(len(rows)), key=lambda row: (-urgency(rows[row]), row))[:MOST_ROWS])
    table = table_of(part_title(title, len(chosen), len(rows)), [rows[row] for row in chosen], *fields)
    if numbered:
        cells = tuple((str(row + 1), *its) for row, its in zip(chosen, table.rows, strict=True))
        table = Table(table.title, (Column("number"), *table.columns), cells)
    return with_rows(without_empty(table))


def part_title(title: str, shown: int, count: int) -> str:
    """Return the title of a table of some of ``count`` rows; it says if rows are missing."""
    return title if shown == count else f"{title}: {shown} of {count}, --json has all"


def without_empty(table: Table) -> Table:
    """Return the table without empty columns."""
    kept = [place for place in range(len(table.columns)) if any(row[place] not in (None, "") for row in table.rows)]
    rows = tuple(tuple(row[place] for place in kept) for row in table.rows)
    return Table(table.title, tuple(table.columns[place] for place in kept), rows)


def format_cell(cell: Cell, number_format: str = "") -> str:
    """Format a cell as text."""
    if cell is None:
        return ""
    if isinstance(cell, str):
        return cell
    if isinstance(cell, Number):
        return f"{figure(cell.value, f'.{cell.decimals}f')} {cell.unit}".rstrip()
    if isinstance(cell, Interval):
        limits = number_format if cell.decimals is None else f".{cell.decimals}f"
        return f"{figure(cell.low, limits)} to {figure(cell.high, limits)}"
    return figure(cell, number_format)


def figure(value: float, number_format: str) -> str:
    """Format a number; it is never minus zero."""
    return format(value, number_format.replace(".", "z.", 1))


def exact_cell(cell: Cell, text: str) -> str:
    """Return the shortest text that reproduces the numbers exactly, in the unit of ``text``; empty if ``text`` does."""
    if isinstance(cell, Number) and not cell.unit:
        cell = cell.value
    if isinstance(cell, Interval):
        return f"{cell.low!r} to {cell.high!r}"
    if not isinstance(cell, float) or text.endswith("%"):
        return ""
    exact = repr(cell)
    return "" if exact == text else exact
