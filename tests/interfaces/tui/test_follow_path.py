"""Paths are planned and driven from the command palette, as the command does it."""

from __future__ import annotations

import shutil
from pathlib import Path

from textual.widgets import Checkbox, Input

from cellapp.cell.run import RunFile
from cellapp.commands.report.result import read_results
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.question import Reading
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.offers import offer_paths
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened, shown_text, until

DAY = Path("logs") / "day"
PATHS = """\
schema: cellapp-paths
version: 1
paths:
  - name: short
    arm: left
    tolerance: 0.1 mm
    speed: 100 mm/s
    poses:
      - {position: [-0.15, -0.75, 0.55], rpy: ["90 deg", 0, 0]}
      - {position: [-0.10, -0.75, 0.55]}
"""


async def test_paths_are_driven_and_shown(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    Path("short.yaml").write_text(PATHS, encoding="utf-8")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        offer_paths(app.day_screen)
        assert "No run is open" in app.message
        app.open_run(DAY)
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        offer_paths(app.day_screen)
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the dialog")
        assert "Begin (b)" in shown_text(app), "all of the dialog fits into the smallest terminal"
        await pilot.press("b")
        await until(pilot, lambda: "path file: missing" in shown_text(app), "what is wrong")
        app.screen.query_one("#path", Input).value = "short.yaml"
        app.screen.query_one("#out", Input).value = "q.csv"
        app.screen.query_one("#rehearse", Checkbox).value = True
        await pilot.press("b")
        await until(pilot, lambda: "a rehearsal moves the arms" in shown_text(app), "what is wrong")
        app.screen.query_one("#rehearse", Checkbox).value = False
        app.screen.query_one("#drive", Checkbox).value = True
        await pilot.press("b")
        await until(pilot, lambda: isinstance(app.screen, Reading), "the tables")
        assert "ms late" in shown_text(app)
        assert Path("q.csv").read_text("utf-8").startswith("path,arm,time_s,s_m,q1")
    with RunFile.open(DAY) as run:
        stored = read_results(run).path
    assert stored is not None
    assert stored.paths[0].driven is not None
