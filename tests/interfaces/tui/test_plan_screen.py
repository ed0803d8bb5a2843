"""The screen Plan: a new run, its maps, its check, its forecast; and what it says where something is missing."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import Input, Static, TabbedContent

from cellapp.cell.planning.planned_stops import read_planned_stops, write_planned_stops
from cellapp.cell.planning.records import PlanForecastResult
from cellapp.cell.planning.view import forecast_run
from cellapp.cell.run import RunFile
from cellapp.commands.plan.run import new_planned_run
from cellapp.ground.progress import Progress, StopReport
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.question import Question
from cellapp.interfaces.tui.dialogs.verb_question import NewRunQuestion
from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.widgets.charts_view import ChartsView
from cellapp.interfaces.tui.widgets.stops_table import StopsTable
from tests.interfaces.page.plan_cases import plan_design
from tests.interfaces.tui.pilot import PROFILES, SIZES, SMALL, HeldJob, ended, opened, shown_text, shows, tells, until
from tests.twin import small_twin, write_profile


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run with a plan of 24 stops. No test may write to it."""
    folder = tmp_path_factory.mktemp("planned") / "run"
    new_planned_run(small_twin(24, plan={"method": "random"}), folder).close()
    return folder


@pytest.fixture(scope="module")
def forecast(planned: Path) -> PlanForecastResult:
    with RunFile.open(planned) as run:
        return forecast_run(run)


async def shown(pilot: Pilot[None], app: CellApp, folder: Path | None) -> None:
    """Open a run and show the screen."""
    await opened(pilot, app)
    if folder is not None:
        app.open_run(folder, app.workspace.profile_path)
        await until(pilot, lambda: app.workspace.folder == folder, "the run")
    await pilot.press("2")
    await until(pilot, lambda: app.day_screen.STEP == "plan" and line(app, "plan-state") != "", "the screen")


def line(app: CellApp, name: str) -> str:
    return str(app.day_screen.query_one(f"#{name}", Static).render())


async def test_a_plan_is_shown_checked_and_foreseen(planned: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await shown(pilot, app, planned)
        assert line(app, "plan-state").startswith("arm left: 24 stops, 0 measured; arm right: 24 stops")
        await shows(pilot, "clearance")
        await pilot.press("k")
        await ended(pilot, app)
        assert line(app, "plan-safety").startswith("Safe: 24 stops and 25 ways")
        await pilot.press("t", "t", "t")
        await until(pilot, lambda: "j computes" in shown_text(app), "what the key would compute")
        await pilot.press("j")
        await ended(pilot, app)
        assert line(app, "plan-time").startswith("Collecting takes about")
        assert line(app, "plan-safety").startswith("Safe"), "the reloaded run has the same plan"


async def test_the_map_follows_what_a_job_measures(planned: Path) -> None:
    events = [Progress("collect", stop + 1, 24, detail=StopReport(stop, "left", 0.1, 0.1)) for stop in range(3)]
    app, held = CellApp(PROFILES), HeldJob(tuple(events))
    async with app.run_test(size=SIZES[-1]) as pilot:
        await shown(pilot, app, planned)
        await until(pilot, lambda: "0 of 24 planned stops" in shown_text(app), "the map")
        app.start_job(held.job(folder=planned))
        await until(pilot, lambda: "3 of 24 planned stops are measured" in shown_text(app), "what is measured by now")
        assert "0 of 24" not in shown_text(app)
        held.go_on.set()
        await ended(pilot, app)


async def test_a_designed_plan_is_drawn_and_its_stops_are_listed(planned: Path, tmp_path: Path) -> None:
    shutil.copytree(planned, tmp_path / "run")
    with RunFile.open(tmp_path / "run", write=True) as run:
        stops = read_planned_stops(run)
        stops.frozen[3] = True
        write_planned_stops(run, stops, design=plan_design(24))
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await shown(pilot, app, tmp_path / "run")
        await pilot.press("t")
        view = app.day_screen.query_one(ChartsView)
        await until(pilot, lambda: len(view.query(ChartPlot)) == 6, "two arms, time, correlations, two of joints")
        assert view.has_focus
        titles = [one.chart.title for one in view.query(ChartPlot) if one.chart is not None]
        assert titles[0] == "Arm left: what the first stops tell"
        await until(pilot, lambda: "↑ expected error [mm]" in shown_text(app), "the first chart")
        await pilot.press("pagedown")
        await until(pilot, lambda: "They tell as much as random stops" in shown_text(app), "the message")
        await pilot.press("t")
        await until(pilot, lambda: "Stop 1: arm left" in line(app, "plan-detail"), "the list of stops")
        await pilot.press("down", "space", "space", "up", "space")
        table = app.day_screen.query_one(StopsTable)
        assert (table.row_count, table.marked) == (24, {1, 3})
        await until(pilot, lambda: "frozen: a new design" in line(app, "plan-detail"), "what is kept")


async def test_a_result_waits_on_its_screen_while_another_one_is_shown(planned: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await shown(pilot, app, planned)
        await pilot.press("k", "1")
        await ended(pilot, app)
        assert app.day_screen.STEP == "cell"
        await pilot.press("2")
        await until(pilot, lambda: app.day_screen.STEP == "plan", "the screen")
        await until(pilot, lambda: line(app, "plan-safety").startswith("Safe"), "the result of the check")


@pytest.mark.parametrize("size", [SIZES[0], SIZES[-1]])
async def test_a_forecast_fits_every_terminal(
    size: tuple[int, int], planned: Path, forecast: PlanForecastResult
) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=size) as pilot:
        await shown(pilot, app, planned)
        maps = list(app.day_screen.query(ChartPlot))
        await until(pilot, lambda: all(one.chart is not None for one in maps), "the maps")
        assert {one.chart.message for one in maps if one.chart is not None} != {""}
        app.day_screen.show_result(forecast)
        await pilot.pause()
        await until(
            pilot,
            lambda: app.day_screen.query_one("#plan-tabs", TabbedContent).active == "tab-forecast",
            "what is shown",
        )
        await until(pilot, lambda: "Collecting takes about" in shown_text(app), "the time")
        assert len(app.day_screen.query("#forecast .table")) == 6, "joints, errors and effects of two arms"
        for widget in app.screen.query("#plan-detail, #plan-tabs, .message"):
            assert app.screen.region.contains_region(widget.region), widget


async def test_a_new_run_goes_into_the_folder_that_one_names(tmp_path: Path) -> None:
    twin = write_profile(tmp_path / "profiles")
    twin.write_text(twin.read_text("utf-8").replace("stops: 30", "stops: 30\n  method: random"), "utf-8")
    for path in (tmp_path / "profiles").glob("*.yaml"):
        if path.stem != "twin":
            path.unlink()
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "notes.txt").write_text("kept")
    (tmp_path / "file").write_text("kept")
    app = CellApp(tmp_path / "profiles")
    async with app.run_test(size=SMALL) as pilot:
        await shown(pilot, app, None)
        assert "No run is open: plan one (keys 2, b)" in line(app, "plan-state")
        await pilot.press("b")
        await until(pilot, lambda: isinstance(app.screen, NewRunQuestion), "the dialog")
        field = app.screen.query_one("#folder", Input)
        assert re.fullmatch(r"logs/twin-\d{8}-\d{6}", Path(field.value).as_posix())
        for value, words in (("", "Type the name"), ("taken", "not empty"), ("file", "is a file")):
            field.value = value
            await pilot.press("enter")
            await pilot.pause()
            assert words in str(app.screen.query_one("#why", Static).render())
        field.value = "monday"
        await pilot.press("enter")
        await ended(pilot, app)
        await until(pilot, lambda: app.workspace.folder == Path("monday"), "the new run")
        assert "30 stops" in line(app, "plan-state")
    assert (tmp_path / "taken" / "notes.txt").read_text() == "kept"


async def test_a_refused_plan_says_which_stop_and_why(tmp_path: Path) -> None:
    down = np.array([[0.0, 0.6, 0.0, -1.5, 0.0, 0.0]])  # bent down into the floor
    RunFile.create(tmp_path / "run", small_twin(1), lambda run: run.write_plan({"left": down, "right": down})).close()
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await shown(pilot, app, tmp_path / "run")
        await pilot.press("k")
        await ended(pilot, app)
        assert line(app, "plan-safety").startswith("Not safe")
        assert app.day_screen.query_one("#plan-tabs", TabbedContent).active == "tab-check"
        await until(pilot, lambda: "floor" in shown_text(app), "the reason")


async def test_what_is_missing_is_said(tmp_path: Path) -> None:
    (tmp_path / "none").mkdir()
    app = CellApp(tmp_path / "none")
    async with app.run_test(size=SMALL) as pilot:
        await until(pilot, lambda: isinstance(app.screen, Question), "the offer of a first start")
        await pilot.press("escape")
        await until(pilot, lambda: app.screen is app.day_screen, "the screen")
        await pilot.press("2")
        await until(pilot, lambda: app.day_screen.STEP == "plan", "the screen")
        for key in ("b", "k", "j"):
            app.say("")
            await pilot.press(key)
            await tells(pilot, "No profile is open: choose one on the screen Cell")
            assert not app.jobs.running
    RunFile.create(tmp_path / "imported", small_twin()).close()
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await shown(pilot, app, tmp_path / "imported")
        assert "its readings were imported" in line(app, "plan-state")
        for key in ("k", "j"):
            app.say("")
            await pilot.press(key)
            await tells(pilot, "has no plan")


async def test_a_profile_that_was_edited_meanwhile_is_told(tmp_path: Path, planned: Path) -> None:
    shutil.copytree(PROFILES, tmp_path / "profiles")
    app = CellApp(tmp_path / "profiles")
    async with app.run_test(size=SMALL) as pilot:
        await shown(pilot, app, planned)
        assert "edited since" in line(app, "plan-state"), "the run has 24 stops, the profile 400"
        twin = tmp_path / "profiles" / "twin.yaml"
        twin.write_text(twin.read_text("utf-8").replace("sede:", "seed:").replace("seed: 1 ", "sede: 1 "), "utf-8")
        await pilot.press("b")
        await until(pilot, lambda: isinstance(app.screen, NewRunQuestion), "the dialog")
        await pilot.press("enter")
        await ended(pilot, app)
        assert "sede" in app.message
