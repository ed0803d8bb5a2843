"""The screen Collect: every kind of event, begin, resume, drift, what a run stores, a full disk, a run in use."""

from __future__ import annotations

import contextlib
import json
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import Static

from cellapp.cell.run import ReferenceRow, RunFile
from cellapp.cell.run.measured_again import earlier_readings
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.record import Verb
from cellapp.ground.errors import InputError
from cellapp.ground.progress import (
    AirReport,
    Detail,
    LogReport,
    MeasurementBegun,
    MotionBegun,
    MotionEnded,
    PointMeasured,
    PointMissed,
    Progress,
    ReferenceReport,
    StateChange,
    StopReport,
    Suspicion,
)
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.question import Choice
from cellapp.interfaces.tui.widgets.chart_plot import ChartPlot
from cellapp.interfaces.tui.widgets.collected_stops import CollectedStops
from cellapp.interfaces.tui.workspace import Workspace
from tests.cell.run.small_runs import add_stop, collected_run, planned_run
from tests.interfaces.tui.pilot import HeldJob, ended, running, shown_text, shows, turned_to, until
from tests.twin import small_twin
from tests.verbs import collect_stops, plan_new_run

Q0 = (0.5,) * 6
Q1 = (-1.0, 0.25, 1.0, 1.5, -0.5, 2.0)
WARM = (31.2, 31.3, 31.4, 31.5, 31.6, 31.7)
EVERY_DETAIL: tuple[Detail, ...] = (
    LogReport("info", "the weather station answers"),
    MotionBegun(3, {"left": Q0, "right": Q0}, {"left": Q1, "right": Q1}, 4.2),
    MotionEnded(3, {"left": Q1, "right": Q1}, {"left": WARM}),
    MeasurementBegun(3, "left"),
    PointMeasured(3, "left", Q1, (1.234567, -0.5, 0.25), 0.0123, 21.25),
    AirReport(21.25, 1013.0, 44.0),
    PointMissed(3, "right", "the beam was broken"),
    *(StopReport(stop, "left", 0.05 + 0.01 * stop, 0.2 / (stop + 1)) for stop in range(4)),
    Suspicion("loose SMR", "fasten the SMR of the left arm", "left"),
    ReferenceReport({"arm left": 0.01}, 0.1),
    ReferenceReport({"arm left": 0.034}, 0.1),
    MotionBegun(None, {"right": Q1}, {"right": Q0}, 3.0),
)
EVERY_KIND = (
    Progress("plan", 30, 30, "done"),
    *(Progress("collect", 4, 30, "stop 5", 7200.0, detail) for detail in EVERY_DETAIL),
)


async def show_collect(pilot: Pilot[None], app: CellApp, run: Path | None = None) -> None:
    """The screen Collect, with a run where one is given."""
    if run is not None:
        app.open_run(run)
        await until(pilot, lambda: app.workspace.folder == run, "the run")
    await pilot.press("3")
    await until(pilot, lambda: app.screen is app.day_screen and app.day_screen.STEP == "collect", "the screen")
    await pilot.pause()


async def begun(
    pilot: Pilot[None], app: CellApp, held: HeldJob, name: str = "collect", last: str = "LOOSE SMR"
) -> None:
    """A job whose events are drawn."""
    app.start_job(held.job(name))
    await until(pilot, lambda: last in shown_text(app), "the events on the screen")


async def finished(pilot: Pilot[None], app: CellApp, held: HeldJob) -> None:
    held.go_on.set()
    await ended(pilot, app)


# -- a job -------------------------------------------------------------------------------------------------------------


# -- a run -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[HeldJob, dict[str, Any]]]:
    """Collections that are asked for: each is held, with what was asked."""
    calls: list[tuple[HeldJob, dict[str, Any]]] = []

    def job_of(verb: Verb, folder: Path, **how: bool) -> object:
        assert verb.name == "collect"
        calls.append((HeldJob(()), {"folder": folder, **how}))
        return calls[-1][0].job(folder=folder)

    monkeypatch.setattr(verb_jobs, "job_of", job_of)
    return calls


async def begin_and_end(pilot: Pilot[None], app: CellApp, asked: list[tuple[HeldJob, dict[str, Any]]]) -> None:
    """The job that was asked for last begins, and is let go on to its end."""
    await until(pilot, lambda: asked and asked[-1][0].reached.is_set(), "the job")
    await finished(pilot, app, asked[-1][0])


async def test_real_arms_ask_with_their_first_path_instead(
    asked: list[tuple[HeldJob, dict[str, Any]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = collected_run(Path("logs/part"), "stopped")
    monkeypatch.setattr(Workspace, "kind", "real")
    async with running() as (pilot, app):
        await show_collect(pilot, app, run)
        await pilot.press("b")
        assert not isinstance(app.screen, Choice)
        await begin_and_end(pilot, app, asked)


async def test_stops_that_were_planned_since_are_offered() -> None:
    run = collected_run(Path("logs/more"), "complete", measured=3)
    async with running() as (pilot, app):
        await show_collect(pilot, app, run)
        await shows(pilot, "READY, 1 stop  b measures 1 stop that is left")


def drifted_run(folder: Path, drift_m: float) -> Path:
    """An interrupted run whose reference moved."""
    with planned_run(folder) as run:
        session = run.begin_session()
        add_stop(run, 0)
        for stops, x in ((0, 0.0), (1, drift_m)):
            run.add_reference(ReferenceRow("arm left", stops, float(stops), np.array([x, 0.0, 0.0]), session))
        run.log("warning", "the reference moved")
        run.end_session(session, "failed", "reference arm left moved")
    return folder


async def test_a_drift_is_shown_and_accepted_only_beyond_its_limit(asked: list[tuple[HeldJob, dict[str, Any]]]) -> None:
    limit_m = planned_limit_m(Path("logs/limit"))
    near, far = drifted_run(Path("logs/near"), 0.5 * limit_m), drifted_run(Path("logs/far"), 2.0 * limit_m)
    async with running() as (pilot, app):
        await show_collect(pilot, app, near)
        await pilot.press("d")
        assert app.screen is app.day_screen
        app.open_run(far)
        await until(pilot, lambda: "d accepts that and resumes." in " ".join(shown_text(app).split()), "the run")
        await pilot.press("g", "g", "g")
        await pilot.pause()
        await shows(pilot, "beyond the limit")
        await pilot.press("d")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question")
        await pilot.press("b")
        await begin_and_end(pilot, app, asked)
        assert asked[0][1] == {"folder": far, "resume": True, "accept_drift": True}


def planned_limit_m(folder: Path) -> float:
    with planned_run(folder) as run:
        return run.profile.collection.reference.drift


async def test_a_job_that_holds_for_a_drift_is_resumed_by_accepting_it() -> None:
    held = HeldJob(
        (
            Progress("collect", 4, 30, detail=ReferenceReport({"arm left": 0.3}, 0.1)),
            Progress("collect", 4, 30, detail=StateChange("stopped", "reference arm left: 0.300 mm from its first")),
        )
    )
    async with running() as (pilot, app):
        await show_collect(pilot, app)
        await begun(pilot, app, held, last="d accepts the")
        app.jobs.control.hold()
        await pilot.press("d")
        await until(pilot, lambda: app.jobs.control.request == "none", "the job that goes on")
        await finished(pilot, app, held)


async def show_tables(pilot: Pilot[None], app: CellApp, run: Path) -> None:
    """What a run stores; it opens on the stops one by one."""
    await show_collect(pilot, app, run)
    await until(pilot, lambda: app.screen.has_class("stops"), "the stops")
    await pilot.press("t")
    await until(pilot, lambda: "Sessions of collecting" in shown_text(app), "the tables")


async def test_what_a_run_stores_and_its_log_are_shown_until_a_job_begins() -> None:
    run = drifted_run(Path("logs/part"), 0.0)
    async with running(size=(120, 40)) as (pilot, app):
        await show_tables(pilot, app, run)
        await shows(pilot, "Sessions of collecting")
        await shows(pilot, "failed")
        await pilot.press("t")
        await until(pilot, lambda: "Log stored in part" in shown_text(app), "the stored log")
        await shows(pilot, "the reference moved")
        await turned_to(pilot, "collected")
        held = HeldJob(EVERY_KIND)
        await begun(pilot, app, held)
        await shows(pilot, "Log of this session")
        await finished(pilot, app, held)


# -- stops one by one --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the twin with residuals; one reading of the right arm is wrong by some centimetres."""
    folder = tmp_path_factory.mktemp("stops") / "run"
    plan_new_run(small_twin(30, plan={"method": "random"}), folder)
    with RunFile.open(folder, write=True) as run:
        collect_stops(run)
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as connection:
        (text,) = connection.execute("SELECT p_m FROM reading WHERE configuration = 11 AND arm = 'right'").fetchone()
        x, y, z = json.loads(text)
        connection.execute(
            "UPDATE reading SET p_m = ? WHERE configuration = 11 AND arm = 'right'", (json.dumps([x + 0.05, y, z]),)
        )
        connection.commit()
    return folder


def stops_of(app: CellApp) -> list[tuple[str, ...]]:
    """The rows of the stops as they are shown."""
    table = app.screen.query_one(CollectedStops).table
    return [tuple(str(cell) for cell in table.get_row_at(row)) for row in range(table.row_count)]


async def show_stops(pilot: Pilot[None], app: CellApp, run: Path) -> None:
    await show_collect(pilot, app, run)
    await turned_to(pilot, "stops")
    await until(pilot, lambda: bool(stops_of(app)), "the stops")
    table = app.screen.query_one(CollectedStops).table
    await until(pilot, lambda: app.focused is table, "the table that takes the keys")


async def test_the_plot_marks_the_row_and_moves_the_cursor(measured_run: Path) -> None:
    async with running(size=(200, 60)) as (pilot, app):
        await show_stops(pilot, app, measured_run)
        plot, stops = app.screen.query_one("#residuals", ChartPlot), app.screen.query_one(CollectedStops)
        await pilot.press("down", "down", "down")
        await until(pilot, lambda: plot.chart is not None and "Chosen: stop 2, arm right" in plot.chart.message, "mark")
        await pilot.press("g", "full_stop")
        await until(pilot, lambda: plot.chart is not None and "Chosen: stop 3, arm left" in plot.chart.message, "next")
        assert stops.table.cursor_row == 4
        await pilot.press("comma")
        await until(pilot, lambda: stops.table.cursor_row == 3, "the one before")


async def test_marked_stops_are_measured_again_after_a_question(measured_run: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(measured_run, tmp_path / "again"))
    async with running(size=(120, 40)) as (pilot, app):
        await show_stops(pilot, app, run)
        await pilot.press("s", "s", "f")  # the gross error alone
        await until(pilot, lambda: [row[0] for row in stops_of(app)] == ["12"], "the suspicious stop")
        await pilot.press("space")
        await until(pilot, lambda: stops_of(app)[0][0] == "* 12", "the mark")
        await shows(pilot, "1 stop is marked: r measures again.")
        await pilot.press("r")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question")
        asked = "Measure 1 stop again, all arms: 12. The readings before are kept and not used"
        assert asked in str(app.screen.query_one(".text", Static).content)
        await pilot.press("n")
        assert not app.jobs.running
        await pilot.press("r", "b")
        await until(pilot, lambda: app.record.name == "collect again", "the job")
        await ended(pilot, app)
        stops = app.day_screen.query_one(CollectedStops)
        await until(pilot, lambda: not stops.table.row_count, "the stops as they are now, none suspicious")
        await turned_to(pilot, "stops")  # the job's log was shown
        await pilot.press("f")
        rows = [row for row in stops_of(app) if row[0] == "12"]
        assert [row[5] for row in rows] == ["again", "again"]
    with RunFile.open(run) as opened:
        assert [one.again for one in opened.sessions()] == ["", "12"]
        assert earlier_readings(opened, "right")[0].configuration.tolist() == [11]


async def test_a_full_disk_holds_the_reading_until_a_person_freed_it(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Path("logs/day")
    new_planned_run(small_twin(30, plan={"method": "random"}), run).close()
    add_stop, full = RunFile.add_stop, [True]

    def refused(self: RunFile, stop: int, rows: Any, *others: Any) -> None:
        if full[0] and len(self.stops_done()) == 3:
            raise InputError("run.sqlite: database or disk is full")
        add_stop(self, stop, rows, *others)

    monkeypatch.setattr(RunFile, "add_stop", refused)
    async with running() as (pilot, app):
        await show_collect(pilot, app, run)
        await shows(pilot, "READY, 30 stops")
        await pilot.press("b")
        await shows(pilot, "Begin to collect?")
        await pilot.press("b")
        await shows(pilot, "STOPPED", "disk is full", "c resumes")
        full[0] = False
        await pilot.press("c")
        await shows(pilot, "COMPLETE, 30 stops")
