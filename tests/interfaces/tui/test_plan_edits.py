"""Editing a plan by keys: stops are frozen, added, designed again; the plan goes out as a table and comes back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import Input, Static, TabbedContent

from cellapp.cell.planning.planned_stops import PlannedStops, read_planned_stops
from cellapp.cell.run import RunFile
from cellapp.commands.plan.run import new_planned_run
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker, SaveAs
from cellapp.interfaces.tui.dialogs.question import Choice
from cellapp.interfaces.tui.dialogs.verb_question import NewRunQuestion, VerbQuestion
from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.widgets.charts_view import ChartsView
from cellapp.interfaces.tui.widgets.stops_table import StopsTable
from tests.interfaces.tui.pilot import SMALL, ended, shown_text, tells, until
from tests.twin import small_twin, write_profile

RUN = Path("run")
PROFILE = Path("profiles/twin.yaml")


@pytest.fixture(autouse=True)
def _profiles(_surroundings: None) -> None:
    """The application is started with profiles: without one it asks what to begin with."""
    write_profile(PROFILE.parent)


def stored(folder: Path = RUN) -> PlannedStops:
    with RunFile.open(folder) as run:
        return read_planned_stops(run)


async def shown(pilot: Pilot[None], app: CellApp, tab: str = "stops") -> None:
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


async def test_marked_stops_are_frozen_and_others_are_added() -> None:
    app = CellApp(PROFILE.parent)
    async with app.run_test(size=SMALL) as pilot:
        await shown(pilot, app)
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
            "what is shown",
        )
        await fill(pilot, app, VerbQuestion, "#add", "2")
        await ended(pilot, app)
        await until(pilot, lambda: table(app).row_count == 10, "the added stops")
        assert np.array_equal(stored().q["left"][:8], before.q["left"])


async def test_a_plan_is_designed_and_designed_again_around_what_is_frozen() -> None:
    text = PROFILE.read_text("utf-8").replace(
        "  stops: 30", "  stops: 10\n  method: designed\n  candidates: 150\n  repeats: 2"
    )
    PROFILE.write_text(text, "utf-8")
    app = CellApp(PROFILE.parent)
    async with app.run_test(size=SMALL) as pilot:
        app.open_profile(PROFILE)
        await until(pilot, lambda: app.workspace.profile_path == PROFILE, "the profile")
        await pilot.press("2", "b")
        await fill(pilot, app, NewRunQuestion, "#folder", str(RUN))
        await ended(pilot, app)
        await until(pilot, lambda: app.workspace.design is not None, "what is known of the design")
        view = app.day_screen.query_one(ChartsView)
        app.day_screen.query_one("#plan-tabs", TabbedContent).active = "tab-design"
        await until(pilot, lambda: len(view.query(ChartPlot)) == 6, "its charts")
        app.day_screen.query_one("#plan-tabs", TabbedContent).active = "tab-stops"
        await until(pilot, lambda: table(app).row_count == 10, "the stops")
        table(app).focus()
        await pilot.press("down", "space", "z")
        await ended(pilot, app)
        before = stored()
        await pilot.press("r")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question")
        await pilot.press("d")
        await ended(pilot, app)
        after = stored()
        assert np.array_equal(after.q["left"][after.frozen], before.q["left"][[1]])
        assert not np.array_equal(np.sort(after.q["left"], axis=0), np.sort(before.q["left"], axis=0))


async def test_a_table_is_written_checked_by_line_and_becomes_a_run() -> None:
    app = CellApp(PROFILE.parent)
    async with app.run_test(size=SMALL) as pilot:
        await shown(pilot, app)
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
        await until(pilot, lambda: "broken.csv: Not safe" in shown_text(app), "the verdict")
        assert "broken.csv:4: configuration" in shown_text(app)
        await pilot.press("o")
        await fill(pilot, app, FilePicker, "#path", "plan.csv")
        await until(pilot, lambda: isinstance(app.screen, Choice), "what to do with it")
        await pilot.press("n")
        await fill(pilot, app, NewRunQuestion, "#folder", "again")
        await ended(pilot, app)
        await until(pilot, lambda: app.workspace.folder == Path("again"), "the new run")
        assert np.array_equal(stored(Path("again")).q["right"], stored().q["right"])


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
