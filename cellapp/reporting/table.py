"""A table as plain data."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A table of texts: title, column heads, rows; the first column names, the others are numbers for eyes."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
