"""The screen Cell: profiles, what they say, what devices say now, the doctor's verdict and its age."""

from __future__ import annotations

import asyncio
import os
import shutil
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from textual.widgets import DataTable, OptionList, Static, TabbedContent

from cellapp.cell.profile import load_profile
from cellapp.commands.doctor.result import DoctorResult
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.progress import ignore
from cellapp.interfaces.tui import work
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.program import MotionQuestion
from cellapp.interfaces.tui.dialogs.question import Choice, Question, Reading
from cellapp.interfaces.tui.host import WorkspaceLoaded
from cellapp.interfaces.tui.jobs import MotionAsked
from cellapp.interfaces.tui.screens.cell import CellScreen
from cellapp.interfaces.tui.widgets.cell_views import FindingsTable
from cellapp.interfaces.tui.workspace import Workspace, load_workspace
from drivers.findings import DeviceReport, Finding
from tests.interfaces.tui.pilot import (
    PROFILES,
    SIZES,
    SMALL,
    HeldJob,
    MovingJob,
    ended,
    opened,
    shown_text,
    tells,
    until,
)
from tests.waiting import WAIT_S

BROKEN = "schema: cellapp-profile\nversion: 1\nname: bad\nsede: 1\n"
UR = DeviceReport(model="UR10", serial="2015", state="RUNNING, NORMAL", joints_c=(25.0, 31.0))


def cell_screen(app: CellApp) -> CellScreen:
    screen = app.day_screen
    assert isinstance(screen, CellScreen)
    return screen


def line(app: CellApp, name: str) -> str:
    return str(app.day_screen.query_one(f"#{name}", Static).render())


@pytest.mark.parametrize("size", [SIZES[0], SIZES[-1]])
async def test_a_profile_stands_in_words_and_the_doctor_has_one_line(size: tuple[int, int]) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=size) as pilot:
        await opened(pilot, app)
        await until(pilot, lambda: "UR10, 6 joints" in shown_text(app), "the profile in words")
        assert line(app, "cell-verdict").startswith("Not checked yet")
        await pilot.press("b")
        await ended(pilot, app)
        assert line(app, "cell-verdict") == "Ready: nothing would be refused."
        assert app.day_screen.query_one("#cell-tabs", TabbedContent).active == "tab-doctor"
        assert app.day_screen.query_one(FindingsTable).row_count == 8
        for widget in app.screen.query("#cell-detail, #cell-verdict, #profiles, Footer"):
            assert app.screen.region.contains_region(widget.region), widget


async def test_failed_checks_come_first_and_are_read_in_full() -> None:
    app = CellApp(PROFILES)
    long = "no answer; " + "see that the controller is switched on, " * 4
    found = DoctorResult(
        findings=(
            Finding(subject="python", status="ok", text="Python"),
            Finding(subject="arm right: serial", status="warning", text="not in the profile"),
            Finding(subject="arm left: link", status="failed", text=long),
            Finding(subject="arm right: link", status="ok", text="CB3", device=UR),
        )
    )
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        cell_screen(app).show_result(found)
        app.draw_all()
        await pilot.pause()
        assert line(app, "cell-verdict") == "1 check failed (1 warning): arm left: link."
        await until(pilot, lambda: line(app, "cell-detail") == f"arm left: link: {long}", "the sentence in full")


async def test_a_doctor_that_is_old_or_of_another_file_is_shown_as_old(tmp_path: Path) -> None:
    shutil.copytree(PROFILES, tmp_path / "profiles")
    app = CellApp(tmp_path / "profiles")
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        await pilot.press("b")
        await ended(pilot, app)
        screen = cell_screen(app)
        screen._doctor_at = datetime.now() - timedelta(minutes=11)
        app.draw_all()
        assert line(app, "cell-verdict").startswith("Old, from 11 min ago: Ready")
        screen._doctor_at = datetime.now()
        os.utime(tmp_path / "profiles" / "twin.yaml", ns=(1, 1))
        app.draw_all()
        assert line(app, "cell-verdict").startswith("Old, the profile was edited since: Ready")
        app.open_profile(tmp_path / "profiles" / "ur10-real.yaml")
        await until(pilot, lambda: line(app, "cell-verdict").startswith("Not checked yet"), "another cell")
        assert app.day_screen.query_one(FindingsTable).row_count == 0


async def test_a_broken_profile_and_none_at_all_are_told(tmp_path: Path) -> None:
    app = CellApp(tmp_path / "nowhere")
    async with app.run_test(size=SMALL) as pilot:
        await until(pilot, lambda: isinstance(app.screen, Question), "the offer of a first start")
        await pilot.press("escape")
        await until(pilot, lambda: app.screen is app.day_screen, "the screen")
        for key in ("b", "r"):
            await pilot.press(key)
            await tells(pilot, "No profile is open")
    (tmp_path / "bad.yaml").write_text(BROKEN)
    app = CellApp(tmp_path)
    async with app.run_test(size=SMALL) as pilot:
        await until(pilot, lambda: bool(app.workspace.problem), "the problem")
        await until(pilot, lambda: "bad.yaml:4  sede: unknown key" in shown_text(app), "its line")
        assert "bad.yaml" in line(app, "cell-verdict")


async def test_a_profile_from_elsewhere_joins_the_list_and_a_run_is_closed_by_enter_only(tmp_path: Path) -> None:
    shutil.copytree(PROFILES, tmp_path / "elsewhere")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        profiles = app.day_screen.query_one("#profiles", OptionList)
        count = profiles.option_count
        await pilot.press("o")
        await until(pilot, lambda: isinstance(app.screen, FilePicker), "the picker")
        app.screen.dismiss(tmp_path / "elsewhere" / "ur5-real.yaml")
        path = tmp_path / "elsewhere" / "ur5-real.yaml"
        await until(pilot, lambda: app.workspace.profile_path == path, "the profile")
        assert profiles.option_count == count + 1
        words = app.day_screen.query_one("#cell-words", DataTable)
        await until(pilot, lambda: words.row_count > 0 and "UR5" in str(words.get_row_at(0)[1]), "its words")


# -- Header and questions speak of the arms that a job moves, whatever is or was open besides --------------------------

REAL = PROFILES / "ur10-ur5.yaml"


def beside_a_simulated_run(app: CellApp) -> Workspace:
    """A simulated run is open, and the profile that is chosen is that of real arms."""
    return Workspace(REAL, app.workspace.profile, Path("logs/simulated"), beside_run=load_profile(REAL))


async def test_a_day_speaks_of_the_chosen_profile_and_not_of_the_run_that_is_open(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    held = HeldJob()
    monkeypatch.setattr("cellapp.interfaces.tui.work.whole_day", lambda path, folder, agreed: held.job("run", folder))
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.workspace = beside_a_simulated_run(app)
        await pilot.press("f5")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question", 5.0)
        await until(pilot, lambda: "; REAL ARMS" in shown_text(app), "whose arms", 5.0)
        await pilot.press("b")
        await until(pilot, lambda: " REAL ARMS " in shown_text(app).splitlines()[0], "the badge")
        assert app.jobs.running
        held.go_on.set()
        await ended(pilot, app)


async def test_what_was_asked_for_before_a_job_began_does_not_hide_its_arms() -> None:
    held = HeldJob()
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        simulated = app.workspace
        app.start_job(held.job(folder=Path("here")), Workspace(REAL, load_profile(REAL)))
        app.show_loaded(WorkspaceLoaded(simulated))
        assert app.workspace.kind == "real"
        held.go_on.set()
        await ended(pilot, app)


def test_a_profile_that_was_edited_after_the_question_moves_nothing(tmp_path: Path) -> None:
    path = Path(shutil.copytree(PROFILES, tmp_path / "profiles")) / "twin.yaml"
    agreed = load_profile(path)
    path.write_text(path.read_text(encoding="utf-8").replace("seed: 1", "seed: 12", 1), encoding="utf-8")
    assert load_profile(path) != agreed
    job = work.whole_day(path, tmp_path / "run", agreed)
    with pytest.raises(InputError, match="was edited since"):
        job.work(ignore, JobControl(), lambda words: True)
    assert not (tmp_path / "run").exists()


async def test_a_question_that_a_stop_has_answered_is_not_asked() -> None:
    moving = MovingJob()
    answers: list[bool] = []
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.start_job(moving.job())
        await asyncio.to_thread(moving.began.wait, WAIT_S)
        await pilot.press("escape")
        app.ask_before_motion(MotionAsked("the first motion", answers.append))
        assert not isinstance(app.screen, MotionQuestion)
        await pilot.press("x")
        await ended(pilot, app)


async def test_a_dialog_names_the_key_that_closes_it_while_escape_stops() -> None:
    held = HeldJob()
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.start_job(held.job())
        await pilot.press("question_mark")
        await until(pilot, lambda: isinstance(app.screen, Reading) and "F10 closes" in shown_text(app), "the key")
        await pilot.press("f10")
        await until(pilot, lambda: not isinstance(app.screen, Reading), "the end of the dialog")
        assert held.control.request == "none"
        held.go_on.set()
        await ended(pilot, app)


def test_values_that_no_version_stores_are_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def damaged(profile_path: Path, profile: object, folder: Path) -> Workspace:
        raise ValueError("stop 3: not a number\nwith more lines")

    monkeypatch.setattr("cellapp.interfaces.tui.workspace._with_run", damaged)
    found = load_workspace(PROFILES / "twin.yaml", Path("logs/old"))
    assert found.problem == "logs/old holds values that this cellapp cannot read (stop 3: not a number)"
    assert found.folder is None
    assert found.profile is not None
