"""The tracker is located from the screen Targets, as the command does it."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.widgets import Input

from cellapp.cell.run import RunFile
from cellapp.commands.locate.request import LocateRequest
from cellapp.commands.report.result import read_results
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.question import Reading
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from tests.interfaces.tui.pilot import PROFILES, SMALL, ended, log_text, opened, shown_text, until


async def test_the_tracker_is_located_and_a_wrong_pose_is_refused(finished_copy: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(finished_copy)
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await pilot.press("6")
        await until(pilot, lambda: app.day_screen.STEP == "targets", "the screen")
        await pilot.press("l")
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the question")
        assert "Not now" in shown_text(app), "all of the dialog fits into the smallest terminal"
        assert app.screen.query_one("#points", Input).value == str(LocateRequest(folder=finished_copy).points)
        app.screen.query_one("#points", Input).value = "many"
        await pilot.press("b")
        await until(pilot, lambda: "points: expected a whole number" in shown_text(app), "what is wrong")
        app.screen.query_one("#points", Input).value = "4"
        app.screen.query_one("#tracker-pose", Input).value = "1,2"
        await pilot.press("b")
        await until(pilot, lambda: "expected x,y,z,roll,pitch,yaw" in app.message, "the refusal")
        await pilot.press("l")
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the question again")
        app.screen.query_one("#tracker-pose", Input).value = "4.1,0.1,0.6,0,0,183"
        app.screen.query_one("#simulated-pose", Input).value = "4.11,0.09,0.61,0,0,183.2"
        await pilot.press("b")
        await until(pilot, lambda: isinstance(app.screen, Reading), "where the tracker stands")
        assert "it stands at" in shown_text(app)
        await ended(pilot, app)
        assert "locate: done; the tracker was located" in log_text(app)
    with RunFile.open(finished_copy) as run:
        found = read_results(run).locate
    assert found is not None
    assert found.tracker_pose.position == pytest.approx((4.11, 0.09, 0.61), abs=0.5e-3)
