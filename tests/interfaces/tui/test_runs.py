"""The list of runs: read in a thread, opened; broken ones are rows."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import DataTable, Static

from cellapp.cell.run import RunFile
from cellapp.commands.record import Work
from cellapp.commands.report.request import ReportRequest
from cellapp.commands.run_results import ReportResult
from cellapp.commands.stages import basis_of
from cellapp.interfaces.tui.app import CellApp
from tests.cell.run.small_runs import collected_run, set_began
from tests.interfaces.tui.pilot import ended, running, tells, until

LOGS = Path("logs")


@pytest.fixture
def logs() -> Path:
    """Three runs and a broken one."""
    runs = (("first", "complete", 4), ("second", "stopped", 2), ("third", "complete", 3))
    for minute, (name, outcome, measured) in enumerate(runs):
        collected_run(LOGS / name, outcome, measured)  # type: ignore[arg-type]
        set_began(LOGS / name, minute)
    (LOGS / "broken").mkdir()
    (LOGS / "broken" / "run.sqlite").write_text("no run")
    return LOGS


def names(app: CellApp) -> list[str]:
    table = app.screen.query_one("#runs", DataTable)
    return [str(table.get_row_at(row)[0]).removeprefix("* ") for row in range(table.row_count)]


def about(app: CellApp) -> str:
    return str(app.screen.query_one("#about", Static).content)


async def show_runs(pilot: Pilot[None], app: CellApp, count: int = 4) -> None:
    """Show the screen and wait for the list."""
    await pilot.press("8")
    await until(pilot, lambda: len(names(app)) == count, "the list")


async def go_to(pilot: Pilot[None], app: CellApp, name: str) -> None:
    table = app.screen.query_one("#runs", DataTable)
    table.move_cursor(row=names(app).index(name))
    await pilot.pause()


async def test_the_path_of_a_report_is_said_and_a_missing_one_is_written(
    logs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (LOGS / "first" / "report.html").resolve()

    def report(request: ReportRequest, given: Work) -> ReportResult:
        page.write_text("<html>")
        return ReportResult(run=str(request.folder), page=str(page))

    monkeypatch.setattr("cellapp.commands.report.run.run", report)
    async with running(size=(120, 40)) as (pilot, app):
        await show_runs(pilot, app)
        await go_to(pilot, app, "first")
        await pilot.press("o")
        await tells(pilot, "is not calibrated; there is nothing to report yet")
        with RunFile.open(LOGS / "first", write=True) as run:
            run.append_stage("calibrate", basis_of(run).model_dump_json(), "{}", None)
        await pilot.press("r")
        await until(pilot, lambda: "calibrate" in about(app), "the list again")
        await pilot.press("o")
        await until(pilot, page.is_file, "the page")
        await ended(pilot, app)
        await pilot.press("8", "o")
        await tells(pilot, f"The report is {page}")
