"""Columns of tables follow their texts, also where a busy computer drew rows before they were measured."""

from __future__ import annotations

import pytest
from rich.text import Text
from textual.app import App, ComposeResult
from textual.widgets import DataTable

from cellapp.interfaces.tui.widgets.text_table import TextTable

pytestmark = pytest.mark.fast


class TableApp(App[None]):
    """One table."""

    def compose(self) -> ComposeResult:
        yield TextTable()


async def test_rows_that_were_drawn_before_they_were_measured_are_drawn_again() -> None:
    app = TableApp()
    async with app.run_test() as pilot:
        table = app.query_one(DataTable)
        table.add_column("id")
        for text in ("short", "a longer text", "a text that is longer still"):
            table.clear()
            table.add_row(Text("a"))
            table.add_row(Text(text))
            table.render_line(2)  # too early: the column is as wide as the texts before
            await pilot.pause()
            assert text in table.render_line(2).text
