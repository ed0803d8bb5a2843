"""The calibrated arms are written for other programs from the screen Calibrate, as the command does."""

from __future__ import annotations

import shutil
from pathlib import Path

from textual.pilot import Pilot
from textual.widgets import Input, OptionList

from cellapp.cell.exports.formats import all_formats
from cellapp.cell.run import RunFile
from cellapp.commands.export.run import export_as_run
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.question import Reading
from cellapp.interfaces.tui.screens.calibrate import ExportArms
from tests.cell.run.small_runs import collected_run
from tests.interfaces.tui.pilot import PROFILES, SMALL, ended, opened, shown_text, tells, until

DAY = Path("logs") / "day"


async def show_calibrate(pilot: Pilot[None], app: CellApp) -> None:
    await opened(pilot, app)
    app.open_run(DAY)
    await until(pilot, lambda: app.workspace.results is not None, "the run")
    await pilot.press("4")
    await until(pilot, lambda: app.day_screen.STEP == "calibrate", "the screen")


async def test_a_format_is_chosen_and_both_arms_are_written(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_calibrate(pilot, app)
        await pilot.press("e")
        await until(pilot, lambda: isinstance(app.screen, ExportArms), "the dialog")
        text = shown_text(app)
        assert all(form in text for form in all_formats())
        assert "Write (Ctrl+S)" in text, "all of the dialog fits into the smallest terminal"
        await pilot.press("down", "down")
        await until(
            pilot, lambda: app.screen.query_one("#out", Input).value == str(DAY / "urdf.urdf"), "the text of the field"
        )
        await pilot.press("enter", "enter")
        await until(pilot, lambda: isinstance(app.screen, Reading), "what was written")
        assert "joint_compliance" in shown_text(app)
        await pilot.press("escape")
        with RunFile.open(DAY) as run:
            export_as_run(run, "urdf", Path("command.urdf"))
        for arm in ("left", "right"):
            assert (DAY / f"urdf-{arm}.urdf").read_bytes() == Path(f"command-{arm}.urdf").read_bytes()


async def test_what_the_verb_refuses_is_said(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_calibrate(pilot, app)
        await pilot.press("e")
        await until(pilot, lambda: isinstance(app.screen, ExportArms), "the dialog")
        app.screen.query_one("#out", Input).value = "mine.yaml"
        app.screen.query_one("#formats", OptionList).highlighted = 3
        await pilot.pause()
        await until(
            pilot, lambda: app.screen.query_one("#out", Input).value == "mine.yaml", "what a person typed stays"
        )
        app.screen.query_one("#arm", Input).value = "third"
        await pilot.press("ctrl+s")
        await until(pilot, lambda: "no calibrated arm 'third'" in app.message, "the reason")
        await ended(pilot, app)
        assert not Path("mine.yaml").exists()


async def test_a_run_without_calibration_has_nothing_to_export() -> None:
    collected_run(DAY, "complete", 3)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_calibrate(pilot, app)
        await pilot.press("e")
        await pilot.pause()
        assert not isinstance(app.screen, ExportArms)
        await tells(pilot, "Not calibrated yet")
