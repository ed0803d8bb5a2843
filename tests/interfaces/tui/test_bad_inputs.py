"""What goes wrong around the application gets a sentence and a way on: broken, edited, locked runs, a full disk."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.sqlite_file import connect
from cellapp.commands.plan.run import new_planned_run
from cellapp.ground.errors import InputError
from cellapp.interfaces.tui.app import CellApp
from tests.interfaces.tui.pilot import SMALL, ended, opened, shows, until
from tests.twin import write_profile

DAY = Path("logs") / "day"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small twin and a planned run of it."""
    made = tmp_path_factory.mktemp("work")
    profile = write_profile(made / "profiles")
    for path in (made / "profiles").glob("*.yaml"):
        if path != profile:
            path.unlink()
    profile.write_text(profile.read_text("utf-8").replace("  stops: 30", "  stops: 30\n  method: random"), "utf-8")
    new_planned_run(load_profile(profile), made / DAY).close()
    return made


@pytest.fixture
def app(folder: Path, tmp_path: Path) -> CellApp:
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    return CellApp(Path("profiles"))


async def open_day(pilot: Pilot[None], app: CellApp) -> None:
    await opened(pilot, app)
    app.open_run(DAY, Path("profiles") / "twin.yaml")
    await until(pilot, lambda: app.workspace.folder == DAY, "the run")


async def collect(pilot: Pilot[None], app: CellApp) -> None:
    """Begin to collect by keys."""
    await pilot.press("3")
    await shows(pilot, "READY, 30 stops")
    await pilot.press("b")
    await shows(pilot, "Begin to collect?")
    await pilot.press("b")


async def test_a_broken_run_among_others_is_named_and_the_others_can_be_opened(app: CellApp) -> None:
    for name, text in (("broken", "no database"), ("empty", "")):
        (Path("logs") / name).mkdir()
        (Path("logs") / name / "run.sqlite").write_text(text)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        await pilot.press("8")
        await shows(pilot, "broken", "empty", "day", "0/30")
        app.open_run(Path("logs") / "broken", app.workspace.profile_path)
        await until(pilot, lambda: "is not a run file" in app.message, "the sentence")
        assert app.workspace.folder is None
        await open_day(pilot, app)
        await shows(pilot, "logs/day is open; next: Collect")


async def test_a_profile_that_was_edited_meanwhile_is_said_and_the_run_goes_on(app: CellApp) -> None:
    profile = Path("profiles") / "twin.yaml"
    async with app.run_test(size=SMALL) as pilot:
        await open_day(pilot, app)
        profile.write_text(profile.read_text("utf-8").replace("averaging: 1.0", "averaging: 2.0"), "utf-8")
        app.open_run(DAY, profile)
        await shows(pilot, "The profile was edited after this run was planned; the run keeps its own copy.")
        await collect(pilot, app)
        await shows(pilot, "COMPLETE, 30 stops")


async def test_a_profile_that_was_broken_meanwhile_is_said_with_file_and_line(app: CellApp) -> None:
    profile = Path("profiles") / "twin.yaml"
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        profile.write_text(profile.read_text("utf-8").replace("clearance: ", "clearence: "), "utf-8")
        app.open_profile(profile)
        await shows(pilot, "profiles/twin.yaml", "clearence")
        profile.write_text(profile.read_text("utf-8").replace("clearence: ", "clearance: "), "utf-8")
        app.open_profile(profile)
        await until(pilot, lambda: app.workspace.profile is not None, "the mended profile")


async def test_a_full_disk_holds_the_reading_until_a_person_freed_it(
    app: CellApp, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_stop, full = RunFile.add_stop, [True]

    def refused(self: RunFile, stop: int, rows: Any, *others: Any) -> None:
        if full[0] and len(self.stops_done()) == 3:
            raise InputError("run.sqlite: database or disk is full")
        add_stop(self, stop, rows, *others)

    monkeypatch.setattr(RunFile, "add_stop", refused)
    async with app.run_test(size=SMALL) as pilot:
        await open_day(pilot, app)
        await collect(pilot, app)
        await shows(pilot, "STOPPED", "disk is full", "c resumes")
        full[0] = False
        await pilot.press("c")
        await shows(pilot, "COMPLETE, 30 stops")


async def test_a_run_in_which_another_program_works_is_refused_and_can_be_tried_again(
    app: CellApp, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connect, "__defaults__", (0.2,))  # the lock is waited for, usually 10 s
    async with app.run_test(size=SMALL) as pilot:
        await open_day(pilot, app)
        with closing(sqlite3.connect(DAY / "run.sqlite")) as other:
            other.execute("BEGIN IMMEDIATE")
            await collect(pilot, app)
            await until(pilot, lambda: "locked" in app.message, "the sentence")
            await ended(pilot, app)
        await collect(pilot, app)
        await shows(pilot, "COMPLETE, 30 stops")
