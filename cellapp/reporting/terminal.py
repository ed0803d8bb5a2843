"""Tables for a terminal."""

from __future__ import annotations

from rich import box
from rich.table import Table as RichTable
from rich.text import Text

from cellapp.reporting.table import Table


def rich_table(table: Table) -> RichTable:
    """A table for Rich's console. Cells are plain text: Rich would read a unit in brackets as markup."""
    drawn = RichTable(title=Text(table.title), title_justify="left", box=box.SIMPLE_HEAD)
    for place, column in enumerate(table.columns):
        drawn.add_column(
            Text(column.heading),
            justify="right" if column.is_number else "left",
            no_wrap=place == 0,
            overflow="fold",  # a narrow terminal breaks a number into lines; it never hides its end
        )
    for row in table.text_rows():
        drawn.add_row(*(Text(cell) for cell in row))
    return drawn
