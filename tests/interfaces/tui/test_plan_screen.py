"""The screen Plan: a new run, its check, its forecast, what is missing; stops are frozen, added, written and read."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import Input, Static, TabbedContent

from cellapp.cell.planning.planned_stops import PlannedStops, read_planned_stops
from cellapp.cell.planning.records import PlanForecastResult
from cellapp.cell.planning.view import forecast_run
from cellapp.cell.run import RunFile
from cellapp.commands.plan.run import new_planned_run
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker, SaveAs
from cellapp.interfaces.tui.dialogs.question import Choice, Question
from cellapp.interfaces.tui.dialogs.verb_question import NewRunQuestion, VerbQuestion
from cellapp.interfaces.tui.widgets.plan_tables import (
    PairsTable,
    StopsTable,
)
from tests.interfaces.tui.pilot import PROFILES, SMALL, ended, opened, shows, tells, until
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
        await until(pilot, lambda: "j computes" in line(app, "plan-detail"), "what the key would compute")
        await pilot.press("j")
        await ended(pilot, app)
        assert line(app, "plan-time").startswith("Collecting takes about")
        assert line(app, "plan-safety").startswith("Safe"), "the reloaded run has the same plan"


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
        assert app.day_screen.query_one("#refusals", PairsTable).row_count >= 1
        await until(pilot, lambda: "floor" in line(app, "plan-detail"), "the reason")


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


RUN = Path("run")
PROFILE = Path("profiles/twin.yaml")


@pytest.fixture
def _profiles(_surroundings: None) -> None:
    """The application is started with profiles: without one it asks what to begin with."""
    write_profile(PROFILE.parent)


def stored(folder: Path = RUN) -> PlannedStops:
    with RunFile.open(folder) as run:
        return read_planned_stops(run)


async def shown_plan(pilot: Pilot[None], app: CellApp, tab: str = "stops") -> None:
    """Open the run and show one of the tabs."""
    new_planned_run(small_twin(8, plan={"method": "random"}), RUN).close()
    app.open_profile(PROFILE)
    app.open_run(RUN, PROFILE)
    await until(pilot, lambda: app.workspace.folder == RUN, "the run")
    await pilot.press("2")
    await until(pilot, lambda: app.day_screen.STEP == "plan", "the screen")
    app.day_screen.query_one("#plan-tabs", TabbedContent).active = f"tab-{tab}"
    await pilot.pause()


def table(app: CellApp) -> StopsTable:
    return app.day_screen.query_one(StopsTable)


async def fill(pilot: Pilot[None], app: CellApp, dialog: type, field: str, text: str) -> None:
    """Answer a dialog by typing into its field."""
    await until(pilot, lambda: isinstance(app.screen, dialog), dialog.__name__)
    await until(pilot, lambda: not app.screen.query(".-active"), "a button that was pressed a moment ago")
    app.screen.query_one(field, Input).value = text
    await pilot.press("enter")


@pytest.mark.usefixtures("_profiles")
async def test_marked_stops_are_frozen_and_others_are_added() -> None:
    app = CellApp(PROFILE.parent)
    async with app.run_test(size=SMALL) as pilot:
        await shown_plan(pilot, app)
        await until(pilot, lambda: table(app).row_count == 8, "the stops")
        table(app).focus()
        await pilot.press("down", "space", "space", "z")
        await ended(pilot, app)
        before = stored()
        assert np.flatnonzero(before.frozen).tolist() == [1, 2]
        await until(pilot, lambda: str(table(app).get_row_at(1)[2]) == "yes", "what is frozen, in the list")
        await pilot.press("+")
        await fill(pilot, app, VerbQuestion, "#add", "many")
        await until(
            pilot,
            lambda: "further stops: expected a whole number" in str(app.screen.query_one("#why", Static).render()),
            "what is shown_plan",
        )
        await fill(pilot, app, VerbQuestion, "#add", "2")
        await ended(pilot, app)
        await until(pilot, lambda: table(app).row_count == 10, "the added stops")
        assert np.array_equal(stored().q["left"][:8], before.q["left"])


@pytest.mark.usefixtures("_profiles")
async def test_a_table_is_written_checked_by_line_and_becomes_a_run() -> None:
    app = CellApp(PROFILE.parent)
    async with app.run_test(size=SMALL) as pilot:
        await shown_plan(pilot, app)
        await pilot.press("e")
        await fill(pilot, app, SaveAs, "#path", "plan.csv")
        await ended(pilot, app)
        lines = Path("plan.csv").read_text("utf-8").splitlines()
        broken = lines[3].split(",")
        place = lines[0].split(",").index("q2")
        broken[place] = "0.6"  # bent down
        Path("broken.csv").write_text("\n".join([*lines[:3], ",".join(broken), *lines[4:], ""]), "utf-8")
        await pilot.press("o")
        await fill(pilot, app, FilePicker, "#path", "broken.csv")
        await ended(pilot, app)
        refusals = app.day_screen.query_one("#refusals", PairsTable)
        await until(pilot, lambda: "broken.csv: Not safe" in refusals.selected_text, "the verdict")
        assert str(refusals.get_row_at(1)[1]).startswith("broken.csv:")
        await pilot.press("o")
        await fill(pilot, app, FilePicker, "#path", "plan.csv")
        await until(pilot, lambda: isinstance(app.screen, Choice), "what to do with it")
        await pilot.press("n")
        await fill(pilot, app, NewRunQuestion, "#folder", "again")
        await ended(pilot, app)
        await until(pilot, lambda: app.workspace.folder == Path("again"), "the new run")
        assert np.array_equal(stored(Path("again")).q["right"], stored().q["right"])


@pytest.mark.usefixtures("_profiles")
async def test_without_a_plan_the_keys_say_what_to_do() -> None:
    RunFile.create(RUN, small_twin()).close()
    app = CellApp(PROFILE.parent)
    async with app.run_test(size=SMALL) as pilot:
        app.open_run(RUN, PROFILE)
        await until(pilot, lambda: app.workspace.folder == RUN, "the run")
        await pilot.press("2")
        await until(pilot, lambda: app.day_screen.STEP == "plan", "the screen")
        for key in ("+", "r", "e"):
            app.say("")
            await pilot.press(key)
            await tells(pilot, "has no plan")
