"""Tables of the report in the terminal."""

from __future__ import annotations

from typing import Literal

from rich.text import Text
from textual.containers import Vertical
from textual.widgets import DataTable, Static

from cellapp.reporting.table import Table


def draw_table(table: Table) -> Vertical:
    """A table with its title. Cells are plain text: Textual would read a unit in brackets as markup."""
    grid: DataTable[Text] = DataTable(cursor_type="none", zebra_stripes=True)
    grid.can_focus = False  # the pane scrolls all tables together
    sides: list[Literal["left", "right"]] = ["right" if column.is_number else "left" for column in table.columns]
    for heading, side in zip(table.headings, sides, strict=True):
        grid.add_column(Text(heading, justify=side))
    for row in table.text_rows():
        grid.add_row(*(Text(cell, justify=side) for cell, side in zip(row, sides, strict=True)))
    return Vertical(Static(table.title, markup=False, classes="title"), grid, classes="table")
