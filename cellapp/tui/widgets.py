"""Pieces of the screen: help texts, tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeVar

from rich.text import Text
from textual.containers import Vertical
from textual.widget import Widget
from textual.widgets import DataTable, Static

from cellapp.reporting.table import Table

W = TypeVar("W", bound=Widget)

HELP: Mapping[str, str] = {
    "profiles": "Profiles: up and down select one, Enter goes to Run.",
    "profile": "Profile to run: select one above, or type the path of another.",
    "folder": "Folder of the run: new or empty. If left blank: a new folder in logs.",
    "run": "Start: plan, collect, calibrate, discover, push. THE ARMS WILL MOVE. (F5, r)",
    "stop": "BRAKE all arms now, over every dialog; then resume or abort. (Escape, s)",
    "pause": "Rest after the present stop; p or c resumes. (p)",
    "resume": "Continue a paused or stopped run; the arms move again. (c, p)",
    "abort": "Brake all arms now and end the run; measured data are kept. (x, Ctrl-X)",
    "progress": "Progress of each step: done of total, the current action, time left.",
    "status": "Current action, or how the run ended.",
    "results": "Left, right, or l and t: log or tables. f: full screen.",
    "log": "Events, newest last: up, down, Page Up and Page Down scroll.",
    "tables": "Errors at held-out stops and at targets: up, down, Page Up, Page Down scroll.",
    "stay": "Continue the run. (n)",
    "leave": "Brake all arms, end the run, wait for its end, then quit. (y)",
    "name": "Type the profile's name, then Enter: the arms move.",
    "refuse": "Do not move: the run ends. (Escape)",
}


def helped(widget: W) -> W:
    """Give a widget the help text of its id."""
    widget.tooltip = HELP[widget.id or ""]
    return widget


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
