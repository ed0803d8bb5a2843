"""Tables of a screen that is drawn while it is being made, or goes away: they are there once there is a place."""

from __future__ import annotations

import pytest
from textual.app import App

from cellapp.interfaces.tui.widgets.charts_view import PartsView
from cellapp.interfaces.tui.widgets.tables import TablesView, WrappedTables


def shown(view: TablesView) -> list[str]:
    return [str(child.render()) for child in view.children]


@pytest.mark.parametrize("kind", [TablesView, WrappedTables, PartsView])
async def test_what_is_said_before_there_is_a_place_for_it_is_said_then(kind: type[TablesView]) -> None:
    app: App[None] = App()
    async with app.run_test() as pilot:
        view = kind("at first")
        view.say_empty("No run is open.")
        await app.mount(view)
        await pilot.pause()
        assert shown(view) == ["No run is open."]
        view.show((), ["out of date"])
        await pilot.pause()
        assert shown(view) == ["out of date"]
        await view.remove()
        view.show((), ["it goes away"])


async def test_parts_that_come_before_there_is_a_place_for_them_are_drawn_then() -> None:
    app: App[None] = App()
    async with app.run_test() as pilot:
        view = PartsView("at first")
        view.show_parts(("a sentence",), ["a mark"])
        await app.mount(view)
        await pilot.pause()
        assert shown(view) == ["a mark", "a sentence"]
