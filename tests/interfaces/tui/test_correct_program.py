"""A program is corrected from the screen Targets, as the command does it."""

from __future__ import annotations

import shutil
from pathlib import Path

from textual.pilot import Pilot
from textual.widgets import DataTable, Input

from cellapp.cell.run import RunFile
from cellapp.commands.correct import correct_run
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.question import Reading
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from tests.interfaces.tui.pilot import PROFILES, SMALL, ended, opened, shown_text, shows, until

DAY = Path("logs") / "day"


async def ask_for_program(pilot: Pilot[None], app: CellApp) -> None:
    await opened(pilot, app)
    app.open_run(DAY)
    await until(pilot, lambda: app.workspace.results is not None, "the run")
    await pilot.press("6")
    await until(pilot, lambda: app.day_screen.STEP == "targets", "the screen")
    await pilot.press("e")
    await until(pilot, lambda: isinstance(app.screen, FilePicker), "the question for the program")
    app.screen.query_one("#path", Input).value = "old.script"
    await pilot.press("enter")
    await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the dialog")


async def test_a_program_is_corrected(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    with RunFile.open(DAY) as run:
        q = run.readings("left").q[5].tolist()
        Path("old.script").write_text(f"# day\nmovej({q})\n", encoding="utf-8")
        correct_run(run, Path("old.script"), Path("command.script"), "left")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await ask_for_program(pilot, app)
        await shows(pilot, "Write (Ctrl+S)")  # all of the dialog fits into the smallest terminal
        await until(
            pilot, lambda: app.screen.query_one("#out", Input).value == "old-corrected.script", "the text of the field"
        )
        app.screen.query_one("#arm", Input).value = "left"
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(app.screen, Reading), "what was written")
        assert "1 target corrected" in shown_text(app)
        await pilot.press("escape")
        assert Path("old-corrected.script").read_bytes() == Path("command.script").read_bytes()
        await until(pilot, lambda: "movej" in shown_text(app), "the table")
        assert app.day_screen.query(DataTable)


async def test_what_the_verb_refuses_is_said(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    Path("old.script").write_text("movej([0,0,0,0,0,0])\n", encoding="utf-8")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await ask_for_program(pilot, app)
        app.screen.query_one("#arm", Input).value = "third"
        await pilot.press("ctrl+s")
        await until(pilot, lambda: "no calibrated arm 'third'" in app.message, "the reason")
        await ended(pilot, app)
        assert not Path("old-corrected.script").exists()
