"""The list of runs: read in a thread, opened; broken ones are rows."""

from __future__ import annotations

import threading
import webbrowser
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.widgets import DataTable, Static

from cellapp.cell.run import RunFile
from cellapp.commands.record import Work
from cellapp.commands.report.request import ReportRequest
from cellapp.commands.run_results import ReportResult
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.widgets import runs_list
from tests.cell.run.small_runs import collected_run, set_began
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened, tells, until

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
    return [Path(str(row.key.value)).name for row in table.ordered_rows]


def about(app: CellApp) -> str:
    return str(app.screen.query_one("#about", Static).content)


async def show_runs(pilot: Pilot[None], app: CellApp, count: int = 4) -> None:
    """Show the screen and wait for the list."""
    await opened(pilot, app)
    await pilot.press("8")
    await until(pilot, lambda: len(names(app)) == count, "the list")


async def go_to(pilot: Pilot[None], app: CellApp, name: str) -> None:
    table = app.screen.query_one("#runs", DataTable)
    table.move_cursor(row=names(app).index(name))
    await pilot.pause()


async def test_the_report_opens_in_a_browser_or_its_path_is_said(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (LOGS / "first" / "report.html").resolve()
    app = CellApp(PROFILES)
    threads: list[threading.Thread] = []

    class Window:
        def open(self, url: str) -> bool:
            threads.append(threading.current_thread())
            return url == page.as_uri()

    def get() -> Any:
        return window

    window: Any = Window()
    monkeypatch.setattr(webbrowser, "get", get)
    monkeypatch.setattr(runs_list, "_has_display", lambda: True)
    async with app.run_test(size=(120, 40)) as pilot:
        await show_runs(pilot, app)
        await go_to(pilot, app, "first")
        await pilot.press("o")
        await tells(pilot, "is not calibrated; there is nothing to report yet")
        page.write_text("<html>")
        await pilot.press("o")
        await until(pilot, lambda: app.message == f"The report opens in a browser: {page}", "the browser")
        assert threads != [threading.main_thread()]
        window = webbrowser.GenericBrowser("lynx")
        await pilot.press("o")
        await until(pilot, lambda: "No browser with a window" in app.message, "the path")
        monkeypatch.setattr(webbrowser, "get", lambda: pytest.fail("no browser is looked for without a display"))
        monkeypatch.setattr(runs_list, "_has_display", lambda: False)
        app.say("")
        await pilot.press("o")
        await until(pilot, lambda: str(page) in app.message, "the path")


async def test_a_report_that_is_missing_is_written_then_opened(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with RunFile.open(LOGS / "first", write=True) as run:
        run.append_stage("calibrate", None, "{}", None)
    page = LOGS / "first" / "report.html"

    def report(request: ReportRequest, given: Work) -> ReportResult:
        return ReportResult(run=str(request.folder), page=str(page))

    said: list[Path] = []

    def open_page(path: Path) -> str:
        said.append(path)
        return "opened"

    monkeypatch.setattr("cellapp.commands.report.run.run", report)
    monkeypatch.setattr("cellapp.interfaces.tui.widgets.runs_list.open_page", open_page)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await show_runs(pilot, app)
        await go_to(pilot, app, "first")
        await pilot.press("o")
        await until(pilot, lambda: said == [page], "the page")
