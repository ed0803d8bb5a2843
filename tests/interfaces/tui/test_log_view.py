"""The log: levels, filter, following the end, copying, saving."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

from textual.pilot import Pilot
from textual.widgets import Input

from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import SaveAs
from cellapp.interfaces.tui.job_record import LEVELS, LogRow
from cellapp.interfaces.tui.widgets.log_pane import LogPane, as_text
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened, shown_text, shows, until

NOON = datetime(2026, 3, 1, 12, 0, 0)


async def shown(pilot: Pilot[None], app: CellApp, rows: list[LogRow]) -> LogPane:
    """The screen Collect with a log."""
    await opened(pilot, app)
    await pilot.press("3")
    await until(pilot, lambda: app.screen.query(LogPane), "the log")
    pane = app.screen.query_one(LogPane)
    await until(pilot, lambda: pane.view.size.width > 0, "the log on the screen")
    pane.show("A log", rows)
    await pilot.pause()
    return pane


MANY = [
    LogRow(NOON + timedelta(seconds=number), LEVELS[number % 4], f"event {number}, {'left' if number % 3 else 'right'}")
    for number in range(400)
]


async def test_keys_show_a_level_and_those_above_and_a_text_only_lines_with_it() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        pane = await shown(pilot, app, MANY)
        for key, levels in (("D", LEVELS), ("E", LEVELS[3:]), ("W", LEVELS[2:]), ("I", LEVELS[1:])):
            await pilot.press(key)
            assert {row.level for row in pane.shown} == set(levels)
        await shows(pilot, "A log: 100 info, 100 warning, 100 error")
        await shows(pilot, "event 399")
        await pilot.press("slash", *"RIGHT", "enter")
        right = [row for row in MANY if "right" in row.text and row.level != "debug"]
        await until(pilot, lambda: pane.shown == right and app.focused is pane.view, "the lines with the text")
        await shows(pilot, "with 'RIGHT'")
        assert "left" not in shown_text(app).partition("with 'RIGHT'")[2]
        await pilot.press("y")
        assert app.clipboard == as_text(right)
        await pilot.press("slash")
        app.screen.query_one("#log-field", Input).value = ""
        await until(pilot, lambda: len(pane.shown) == 300, "all lines")


async def test_it_follows_the_end_unless_somebody_looks_up() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        pane = await shown(pilot, app, [])
        pane.show("Log of this session", MANY, stored=False)
        await shows(pilot, "event 399")
        app.say("the newest")
        await until(pilot, lambda: "the newest" in shown_text(app).partition("event 399")[2], "the newest line")
        await pilot.press("pageup")
        await until(pilot, lambda: not pane.view.auto_scroll, "a look at what is above")
        at = pane.view.scroll_offset.y
        app.record.note("newer still")
        await until(pilot, lambda: pane.shown[-1].text == "newer still", "a newer line")
        await pilot.pause()
        assert pane.view.scroll_offset.y == at
        assert "newer still" not in shown_text(app)
        await pilot.press("end")
        await shows(pilot, "newer still")
        assert pane.view.auto_scroll
        await pilot.resize_terminal(120, 40)
        await shows(pilot, "newer still")


async def test_shown_lines_are_saved_and_nothing_is_replaced_unasked(tmp_path: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        pane = await shown(pilot, app, MANY[:5])
        file = tmp_path / "log.txt"
        file.write_text("kept", encoding="utf-8")
        await pilot.press("w")
        await until(pilot, lambda: isinstance(app.screen, SaveAs), "the dialog")
        await until(pilot, lambda: app.screen.query_one("#path", Input).value == file.name, "the text of the field")
        await pilot.press("enter")
        await shows(pilot, "exists")
        assert file.read_text("utf-8") == "kept"
        await pilot.press("enter")
        await until(pilot, lambda: app.screen is app.day_screen, "the end of the dialog")
        assert file.read_text("utf-8") == as_text(pane.shown)
