"""An arm is calibrated with an earlier run as prior from the screen Calibrate, as the command does."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
from textual.widgets import Input

from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.report.result import read_results
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.question import Choice
from tests.interfaces.tui.pilot import PROFILES, SMALL, ended, opened, shown_text, until

DAY, EARLIER = Path("logs") / "day", Path("logs") / "earlier"


async def test_the_earlier_run_is_chosen_and_shown(finished_run: Path) -> None:
    shutil.copytree(finished_run, EARLIER)
    with RunFile.open(EARLIER) as before, RunFile.create(DAY, before.profile) as run:
        for name in run.profile.arms:
            readings = before.readings(name)
            moved = readings.p_M + np.array([0.01, 0.02, 0.03])  # the same stops, seen from another place
            run.add_readings(name, replace(readings, p_M=moved))
        calibrate_run(run)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(DAY)
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await pilot.press("4")
        await until(pilot, lambda: app.day_screen.STEP == "calibrate", "the screen")
        await pilot.press("i")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question, as the calibration holds")
        assert "Calibrate again, with a prior?" in shown_text(app)
        await pilot.press("n", "i")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question again")
        await pilot.press("b")
        await until(pilot, lambda: isinstance(app.screen, FilePicker), "the dialog")
        app.screen.query_one("#path", Input).value = str(EARLIER / "run.sqlite")
        await pilot.press("enter")
        await ended(pilot, app)
    with RunFile.open(DAY) as run:
        result = read_results(run).calibrate
    assert result is not None
    assert all(arm.prior is not None and arm.prior.stage == "discover" for arm in result.arms.values())
