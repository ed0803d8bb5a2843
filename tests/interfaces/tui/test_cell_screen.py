"""The screen Cell: profiles, what they say, what devices say now, the doctor's verdict and its age."""

from __future__ import annotations

import os
import re
import shutil
import threading
from collections.abc import Collection
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from textual.widgets import DataTable, OptionList, Static, TabbedContent

from cellapp.commands.doctor.result import DeviceReport, DoctorResult, Finding
from cellapp.ground.profile import Profile
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.question import Question
from cellapp.interfaces.tui.screens.cell import CellScreen, DevicesProbed
from cellapp.interfaces.tui.widgets.cell_views import DevicesTable, FindingsTable, age_words
from tests.interfaces.tui.pilot import PROFILES, SIZES, SMALL, HeldJob, ended, opened, shown_text, tells, until
from tests.waiting import WAIT_S

pytestmark = pytest.mark.fast

BROKEN = "schema: cellapp-profile\nversion: 1\nname: bad\nsede: 1\n"
UR = DeviceReport(model="UR10", serial="2015", state="RUNNING, NORMAL", joints_c=(25.0, 31.0))


def cell_screen(app: CellApp) -> CellScreen:
    screen = app.day_screen
    assert isinstance(screen, CellScreen)
    return screen


def line(app: CellApp, name: str) -> str:
    return str(app.day_screen.query_one(f"#{name}", Static).render())


def device_rows(app: CellApp) -> list[list[str]]:
    table = app.day_screen.query_one(DevicesTable)
    return [[str(cell) for cell in table.get_row_at(row)] for row in range(table.row_count)]


@pytest.mark.slow
@pytest.mark.parametrize("size", [SIZES[0], SIZES[-1]])
async def test_a_profile_stands_in_words_and_the_doctor_has_one_line(size: tuple[int, int]) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=size) as pilot:
        await opened(pilot, app)
        await until(pilot, lambda: "UR10, 6 joints" in shown_text(app), "the profile in words")
        assert line(app, "cell-verdict").startswith("Not checked yet")
        assert [row[2] for row in device_rows(app)] == ["never"] * 3
        await pilot.press("b")
        await ended(pilot, app)
        assert line(app, "cell-verdict") == "Ready: nothing would be refused."
        assert app.day_screen.query_one("#cell-tabs", TabbedContent).active == "tab-doctor"
        assert app.day_screen.query_one(FindingsTable).row_count == 8
        assert {row[1] for row in device_rows(app)} == {"✓ ok"}
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
        left, right, tracker = device_rows(app)
        assert left[1] == "✗ failed"
        assert right[1] == "! warning"
        assert re.fullmatch(r"now|\d+ s ago", right[2]), "a busy computer draws seconds later"
        assert right[3:] == ["2015", "joints 25.0 to 31.0 °C", "RUNNING, NORMAL"]
        assert tracker[2] == "never"


@pytest.mark.slow
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


@pytest.mark.slow
async def test_devices_are_asked_again_and_again_but_not_while_a_job_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, ...]] = []
    go_on = threading.Event()

    def probe(profile: Profile, names: Collection[str]) -> DoctorResult:
        asked.append(tuple(names))
        assert go_on.wait(WAIT_S)
        link = Finding(subject="arm left: link", status="ok", text="CB3", device=UR)
        return DoctorResult(findings=(link,))

    monkeypatch.setattr("cellapp.commands.doctor.run.probe_devices", probe)
    app = CellApp(PROFILES)
    held = HeldJob()
    async with app.run_test(size=(120, 40)) as pilot:
        await opened(pilot, app)
        screen = cell_screen(app)
        screen._tick()
        assert asked == [], "a simulated cell is not asked"
        app.open_profile(PROFILES / "ur10-ur5.yaml")
        await until(pilot, lambda: app.workspace.kind == "real", "the real cell")
        screen._tick()
        screen._tick()  # the first question is still open
        await until(pilot, lambda: asked == [("arm left", "arm right")], "the question")
        go_on.set()
        await until(pilot, lambda: device_rows(app)[0][3] == "2015", "the answer")
        assert app.start_job(held.job())
        screen._tick()
        await pilot.press("r")
        await tells(pilot, "job uses the devices")
        assert len(asked) == 1
        held.go_on.set()
        await ended(pilot, app)
        await pilot.press("r")
        await until(pilot, lambda: len(asked) == 2, "the second question")
        assert asked[1] == ("arm left", "arm right", "tracker")
        await until(pilot, lambda: not screen._probing, "its answer")
        assert app.workspace.profile is not None
        before = device_rows(app)
        other = app.workspace.profile.model_copy()
        screen.post_message(DevicesProbed(other, DoctorResult(findings=())))
        await pilot.pause()
        assert [row[3] for row in device_rows(app)] == [row[3] for row in before]


@pytest.mark.slow
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
        assert device_rows(app) == []


@pytest.mark.slow
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


def test_ages_in_words() -> None:
    assert [age_words(seconds) for seconds in (0.5, 12.0, 200.0)] == ["now", "12 s ago", "3 min ago"]
