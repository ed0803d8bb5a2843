"""The log: levels, filter, search, marks, following the end, saving; the rows by themselves and in the application."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from textual.pilot import Pilot
from textual.widgets import Input

from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import SaveAs
from cellapp.interfaces.tui.job_record import LEVELS, MOST_LINES, Level, LogRow
from cellapp.interfaces.tui.widgets.log_view import LogView
from cellapp.interfaces.tui.widgets.log_view_pane import LogHeading
from cellapp.interfaces.tui.widgets.log_view_rows import LogFilter, LogRows, as_text
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened, shown_text, shows, until

NOON = datetime(2026, 3, 1, 12, 0, 0)


def rows_of(*texts: str, level: Level = "info") -> list[LogRow]:
    return [LogRow(NOON + timedelta(seconds=number), level, text) for number, text in enumerate(texts)]


texts = st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), max_size=120)
logs = st.lists(st.builds(LogRow, st.just(NOON), st.sampled_from(LEVELS), texts), max_size=30)


@given(first=logs, more=logs, width=st.integers(8, 120), least=st.sampled_from(LEVELS), text=texts)
def test_added_rows_are_laid_out_as_if_all_had_been_there(
    first: list[LogRow], more: list[LogRow], width: int, least: Level, text: str
) -> None:
    wanted = LogFilter(least, text[:2])
    grown, whole = LogRows(), LogRows()
    grown.replace(first, dated=False)
    grown.arrange(width, wanted)
    grown.add(more)
    whole.replace([*first, *more], dated=False)
    whole.arrange(width, wanted)
    assert grown.shown == whole.shown == [row for row in (*first, *more) if wanted.passes(row)]
    assert grown.lines() == whole.lines()
    assert grown.height == len(grown.lines())
    assert sum(grown.counts.values()) == len(first) + len(more)
    for y, line in enumerate(grown.lines()):
        found = grown.line(y)
        assert found is not None
        assert found.text == line
        start, height = grown.extent(found.number)
        assert start <= y < start + height
        assert found.is_first == (y == start)
    assert grown.line(grown.height) is None


def test_the_oldest_rows_go_where_there_are_too_many() -> None:
    rows = LogRows()
    for start in range(0, 3 * MOST_LINES, 500):
        rows.add(rows_of(*(f"row {number}" for number in range(start, start + 500))))
        assert len(rows.rows) <= MOST_LINES + 500
    assert rows.rows[-1].text == f"row {3 * MOST_LINES - 1}"
    assert rows.height == len(rows.shown) == sum(rows.counts.values()) == len(rows.rows)


async def shown(pilot: Pilot[None], app: CellApp, rows: list[LogRow]) -> LogView:
    """The screen Collect with a log."""
    await opened(pilot, app)
    await pilot.press("3")
    await until(pilot, lambda: app.screen.query(LogView), "the log")
    view = app.screen.query_one(LogView)
    await until(pilot, lambda: view.size.width > 0, "the log on the screen")
    view.show_rows(rows)
    await pilot.pause()
    return view


MANY = [
    LogRow(NOON, LEVELS[number % 4], f"event {number} of arm {'left' if number % 3 else 'right'}")
    for number in range(400)
]


async def test_keys_and_clicks_show_a_level_and_those_above() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        view = await shown(pilot, app, MANY)
        for key, levels in (("D", LEVELS), ("I", LEVELS[1:]), ("W", LEVELS[2:]), ("E", LEVELS[3:])):
            await pilot.press(key)
            assert {row.level for row in view.rows.shown} == set(levels)
            assert view.rows.counts["error"] == 100
        await shows(pilot, "error 100")
        heading = app.screen.query_one(LogHeading)
        place = shown_text(app).splitlines()[heading.region.y].index("warning")
        await pilot.click(heading, offset=(place + 1 - heading.region.x, 0))
        assert view.rows.filter.least == "warning"


async def test_it_follows_the_end_unless_somebody_looks_up() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        view = await shown(pilot, app, MANY)
        assert view.follows
        await shows(pilot, "event 399")
        view.add_rows(rows_of("the newest"))
        await pilot.pause()
        await shows(pilot, "the newest")
        await pilot.press("pageup")
        await until(pilot, lambda: not view.follows, "a look at what is above")
        at = view.scroll_offset.y
        view.add_rows(rows_of("newer still"))
        await pilot.pause()
        assert view.scroll_offset.y == at
        assert "newer still" not in shown_text(app)
        await shows(pilot, "End: newest")
        await pilot.press("end")
        await pilot.pause()
        assert view.follows
        await shows(pilot, "newer still")


async def test_search_as_it_is_typed_and_the_next_matches() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        view = await shown(pilot, app, MANY)
        await pilot.press("slash", *"event 10")
        await pilot.pause()
        assert view.wanted == "event 10"
        found = [number for number, row in enumerate(view.rows.shown) if "event 10" in row.text]
        await shows(pilot, f"match {len(found)} of {len(found)}")
        await pilot.press("enter")
        await until(pilot, lambda: app.focused is view, "the focus")
        await pilot.press(".")  # after the last comes the first
        await pilot.pause()
        await shows(pilot, f"match 1 of {len(found)}")
        assert view.chosen() == [view.rows.shown[found[0]]]
        await pilot.press(".")
        await until(pilot, lambda: view.chosen() == [view.rows.shown[found[1]]], "the next match")
        await pilot.press(",", ",")
        await until(pilot, lambda: view.chosen() == [view.rows.shown[found[-1]]], "the match two before")
        await pilot.press("slash")
        app.screen.query_one("#log-field", Input).value = "nowhere"
        await pilot.pause()
        await shows(pilot, "no match")


async def test_filter_by_a_text_shows_only_lines_with_it() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        view = await shown(pilot, app, MANY)
        await pilot.press("f", *"RIGHT", "enter")
        right = [row for row in MANY if "right" in row.text and row.level != "debug"]
        await until(pilot, lambda: view.rows.shown == right, "the lines with the text")
        await shows(pilot, "filter 'RIGHT'")
        view.add_rows(rows_of("of the left arm", "of the right arm"))
        assert view.rows.shown[-1].text == "of the right arm"
        assert all("right" in row.text for row in view.rows.shown)
        await pilot.press("f")
        app.screen.query_one("#log-field", Input).value = ""
        await pilot.pause()
        assert len(view.rows.shown) == 302


async def write_over(pilot: Pilot[None], app: CellApp, file: Path) -> str:
    """Save into a file that is there, after the question; return what it holds then."""
    before = file.read_text("utf-8")
    await pilot.press("w")
    await until(pilot, lambda: isinstance(app.screen, SaveAs), "the dialog")
    await until(pilot, lambda: app.screen.query_one("#path", Input).value == file.name, "the text of the field")
    await pilot.press("enter")
    await shows(pilot, "exists")
    assert isinstance(app.screen, SaveAs)
    assert file.read_text("utf-8") == before
    await pilot.press("enter")
    await until(pilot, lambda: app.screen is app.day_screen, "the end of the dialog")
    return file.read_text("utf-8")


async def test_marked_lines_are_copied_and_saved_and_nothing_is_replaced_unasked(tmp_path: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        view = await shown(pilot, app, rows_of(*(f"row {number}" for number in range(5))))
        await pilot.press("home", "down", "shift+down", "shift+down", "y")
        await until(pilot, lambda: app.clipboard == as_text(view.rows.shown[1:4]), "the copy")
        (tmp_path / "log.txt").write_text("kept", encoding="utf-8")
        assert await write_over(pilot, app, tmp_path / "log.txt") == as_text(view.rows.shown[1:4])
        await pilot.press("end")  # no line is marked: all that are shown
        assert await write_over(pilot, app, tmp_path / "log.txt") == as_text(view.rows.shown)


async def test_text_selected_with_the_mouse_is_copied() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        view = await shown(pilot, app, rows_of("first row", "second row"))
        await pilot.mouse_down(view, offset=(11, 0))
        await pilot.hover(view, offset=(17, 1))
        await pilot.mouse_up(view, offset=(17, 1))
        await pilot.pause()
        await pilot.press("y")
        assert app.clipboard.startswith("first row\n12:00:01")
        assert "second" in app.clipboard
        assert "row" not in app.clipboard.splitlines()[1]
