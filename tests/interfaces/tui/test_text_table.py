"""Tables have all their rows and columns as wide as their texts, also where a busy computer draws them early."""

from __future__ import annotations

import asyncio

from rich.text import Text
from textual.app import App, ComposeResult
from textual.widgets import DataTable

from cellapp.interfaces.tui.widgets.tables import TextTable
from tests.interfaces.tui.pilot import WAIT_S


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


async def test_a_table_whose_place_is_asked_for_before_the_layout_has_its_rows() -> None:
    """The layout that follows takes such a table for shown already and sends it no message."""
    app: App[None] = App()
    async with app.run_test() as pilot:
        table = TextTable(cursor_type="none")
        table.add_column("id")
        table.add_row(Text("a text"))
        app.screen.mount(table)
        async with asyncio.timeout(WAIT_S):
            while not table.is_mounted:
                await asyncio.sleep(0)
        compositor = app.screen._compositor
        compositor._full_map_invalidated = True  # as a widget does that is drawn before it has its place
        assert table in compositor.full_map
        await pilot.pause()
        assert table.virtual_size.height == 2
