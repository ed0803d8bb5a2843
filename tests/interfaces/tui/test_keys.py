"""One grammar of keys: a meaning has one key on every screen, footers break nowhere; Escape and n."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest
from textual.binding import Binding
from textual.dom import DOMNode
from textual.widgets import Input

from cellapp.interfaces.tui import work
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.question import Choice, Reading
from cellapp.interfaces.tui.keys import KEYS, WAYS, key_table
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.controls import Entry, KeyLine, key_lines
from cellapp.interfaces.tui.widgets.log_view_pane import LogField
from tests.cell.run.small_runs import collected_run
from tests.interfaces.tui.pilot import PROFILES, SIZES, SMALL, HeldJob, MovingJob, ended, opened, shown_text, until

RUN = Path("logs/day")
OF_TABLE = {key.keys for key in KEYS.values()}
OWN = {"escape", "ctrl+c", "ctrl+x", "ctrl+q", "ctrl+p", *(entry.key for entry in SCREENS)}
"""Stop and abort wherever one is, and the screens; what is left is in the table."""


def screens() -> list[type[DayScreen]]:
    return [type(entry.make()) for entry in SCREENS]  # type: ignore[misc]


@pytest.mark.fast
def test_a_key_has_one_meaning_and_a_meaning_one_key() -> None:
    used = [name for key in KEYS.values() for name in key.keys.split(",")]
    assert len(used) == len(set(used))
    assert len({key.shown for key in KEYS.values()}) == len(KEYS)


@pytest.mark.fast
@pytest.mark.parametrize("of", [CellApp, *screens()])
def test_every_binding_is_from_the_table_and_bound_once(of: type[DOMNode]) -> None:
    bound = [one for one in of.BINDINGS if isinstance(one, Binding)]
    strange = [one.key for one in bound if one.key not in OF_TABLE | OWN]
    assert not strange, "declare its meaning in keys.py"
    keys = [one.key for one in bound if one.key not in ("ctrl+c",)]
    assert len(keys) == len(set(keys))


@pytest.mark.fast
def test_every_way_to_a_verb_is_a_key_of_its_screen() -> None:
    by_step = {entry.step: type(entry.make()) for entry in SCREENS}
    for verb, (step, meaning) in WAYS.items():
        keys = [one.key for one in by_step[step].BINDINGS if isinstance(one, Binding)]
        assert KEYS[meaning].keys in keys, verb


@pytest.mark.fast
@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_footers_break_between_entries_only_and_keep_the_general_ones(width: int) -> None:
    own = [Entry(letter, "A few words", "") for letter in "abcdefghijklmnop"]
    general = [Entry(key, word, "", general=True) for key, word in (("n", "Next"), ("?", "Help"), ("q", "Quit"))]
    lines = key_lines([*own, *general], width)
    assert 1 <= len(lines) <= 2
    assert all(sum(entry.width for entry in line) <= width for line in lines)
    shown = [entry for line in lines for entry in line]
    assert shown[-3:] == general
    assert shown[:-3] == own[: len(shown) - 3], "the last ones are left out, help has them"


async def test_no_screen_parts_a_key_from_its_label() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        for size, entry in product(SIZES, SCREENS):
            await pilot.resize_terminal(*size)
            await pilot.press(entry.key)
            await pilot.pause()
            line = app.screen.query_one(KeyLine)
            await until(pilot, lambda line=line: "Quit" in shown_text(app).splitlines()[-1], "the footer")  # type: ignore[misc]
            labels = [
                one.binding.description
                for one in app.screen.active_bindings.values()
                if one.binding.show and one.enabled
            ]
            assert 1 <= line.size.height <= 2
            for text in shown_text(app).splitlines()[-line.size.height :]:
                assert any(text.rstrip().endswith(label) for label in labels), text


async def test_help_lists_every_key_of_the_screen() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        for entry in SCREENS:
            await pilot.press(entry.key, "question_mark")
            await until(pilot, lambda: isinstance(app.screen, Reading), "the help")
            text = app.screen._text  # type: ignore[attr-defined]
            assert "{" not in text
            table = key_table(type(app.day_screen).BINDINGS)
            assert table in text
            assert len(table.splitlines()) > 4
            await pilot.press("escape")
            await until(pilot, lambda: app.screen is app.day_screen, "the screen")


async def test_the_next_step_is_begun_where_its_screen_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "interrupted_run", lambda logs: None)
    collected_run(RUN, "stopped")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(RUN)
        await until(pilot, lambda: app.workspace.folder == RUN, "the run")
        await pilot.press("n")
        await until(pilot, lambda: app.day_screen.STEP == "collect", "the screen of the step")
        await pilot.press("n")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question of the step")
        assert "Measure the 2 stops that are left" in " ".join(shown_text(app).split())


async def test_a_stop_leaves_the_field_so_that_the_next_key_is_one_of_the_job() -> None:
    moving = MovingJob()
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        await pilot.press("3")
        app.start_job(moving.job())
        await until(pilot, moving.began.is_set, "the job")
        await pilot.press("slash", *"suspi")
        assert isinstance(app.focused, LogField)
        await pilot.press("escape")
        assert moving.control.request == "stop"
        assert not isinstance(app.focused, Input)
        app.presses._said_s = -1.0  # the stop was long ago
        await pilot.press("c")
        assert moving.control.request == "none"
        await until(pilot, lambda: app.screen.query_one(LogField).value == "suspi", "the text of the field")
        await pilot.press("x")
        await ended(pilot, app)


async def test_escape_closes_what_is_open_before_it_ends_a_calculation() -> None:
    held = HeldJob()
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        job = held.job("calibrate")
        app.start_job(type(job)(job.name, job.work))
        await until(pilot, held.reached.is_set, "the job")
        await pilot.press("question_mark")
        await until(pilot, lambda: isinstance(app.screen, Reading), "the help")
        assert "Escape closes" in shown_text(app)
        await pilot.press("escape")
        await until(pilot, lambda: app.screen is app.day_screen, "the screen")
        assert not held.control.cancelled
        await pilot.press("question_mark", "ctrl+c")
        assert held.control.cancelled, "Ctrl-C stops over a dialog, too"
        held.go_on.set()
        await ended(pilot, app)
