"""The screen Cell: profiles, what devices say now, the doctor's verdict and its age, editing a profile."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from textual.widgets import Static, TabbedContent

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.starters import copy_starter
from cellapp.commands.doctor.request import VERB
from cellapp.commands.doctor.result import DoctorResult
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.first_run import Welcome
from cellapp.interfaces.tui.dialogs.program import MotionQuestion
from cellapp.interfaces.tui.dialogs.question import Choice
from cellapp.interfaces.tui.screens.cell import CellScreen
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
    running,
    shown_text,
    shows,
    tells,
    until,
)
from tests.interfaces.tui.terminal import Terminal
from tests.waiting import WAIT_S

UR = DeviceReport(model="UR10", serial="2015", state="RUNNING, NORMAL", joints_c=(25.0, 31.0))


def cell_screen(app: CellApp) -> CellScreen:
    screen = app.day_screen
    assert isinstance(screen, CellScreen)
    return screen


def line(app: CellApp, name: str) -> str:
    return str(app.day_screen.query_one(f"#{name}", Static).render())


async def test_failed_checks_come_first_and_are_read_in_full() -> None:
    long = "no answer; " + "see that the controller is switched on, " * 4
    found = DoctorResult(
        findings=(
            Finding(subject="python", status="ok", text="Python"),
            Finding(subject="arm right: serial", status="warning", text="not in the profile"),
            Finding(subject="arm left: link", status="failed", text=long),
            Finding(subject="arm right: link", status="ok", text="CB3", device=UR),
        )
    )
    async with running() as (pilot, app):
        cell_screen(app).show_result(found, VERB.view(found))
        app.draw_all()
        await pilot.pause()
        assert line(app, "cell-verdict").startswith("1 check failed (1 warning): arm left: link. Checked at ")
        listed = app.day_screen.query_one("#tab-doctor PartsView")
        await until(pilot, lambda: len(listed.children) == len(found.findings), "the checks")
        first = " ".join(str(listed.query(Static).first().render()).split())
        assert first == f"failed arm left: link: {long}".strip()


async def test_a_doctor_of_another_file_is_shown_as_old(tmp_path: Path) -> None:
    shutil.copytree(PROFILES, tmp_path / "profiles")
    async with running(tmp_path / "profiles") as (pilot, app):
        await pilot.press("b")
        await ended(pilot, app)
        assert line(app, "cell-verdict").startswith("Ready: nothing would be refused")
        os.utime(tmp_path / "profiles" / "twin.yaml", ns=(1, 1))
        app.draw_all()
        assert line(app, "cell-verdict").startswith("Old, the profile was edited since: Ready")
        app.open_profile(tmp_path / "profiles" / "ur10-real.yaml")
        await until(pilot, lambda: line(app, "cell-verdict").startswith("Not checked yet"), "another cell")
        await pilot.press("t")
        await shows(pilot, "asks the doctor")


# -- Header and questions speak of the arms that a job moves, whatever is or was open besides --------------------------

REAL = PROFILES / "ur10-ur5.yaml"


def beside_a_simulated_run(app: CellApp) -> Workspace:
    """A simulated run is open, and the profile that is chosen is that of real arms."""
    return Workspace(REAL, app.workspace.profile, Path("logs/simulated"), beside_run=load_profile(REAL))


async def test_a_day_speaks_of_the_chosen_profile_and_not_of_the_run_that_is_open(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    held = HeldJob()
    monkeypatch.setattr("cellapp.interfaces.tui.verb_jobs.whole_day", lambda path, folder, _: held.job("run", folder))
    async with running() as (pilot, app):
        app.workspace = beside_a_simulated_run(app)
        await pilot.press("f5")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question", 5.0)
        await until(pilot, lambda: "; REAL ARMS" in shown_text(app), "whose arms", 5.0)
        await pilot.press("b")
        await until(pilot, lambda: " REAL ARMS " in shown_text(app).splitlines()[0], "the badge")
        assert app.jobs.running
        held.go_on.set()
        await ended(pilot, app)


def test_a_profile_that_was_edited_after_the_question_moves_nothing(tmp_path: Path) -> None:
    path = Path(shutil.copytree(PROFILES, tmp_path / "profiles")) / "twin.yaml"
    agreed = load_profile(path)
    path.write_text(path.read_text(encoding="utf-8").replace("seed: 1", "seed: 12", 1), encoding="utf-8")
    assert load_profile(path) != agreed
    job = verb_jobs.whole_day(path, tmp_path / "run", agreed)
    with pytest.raises(InputError, match="was edited since"):
        job.work(JobControl(), lambda words: True)
    assert not (tmp_path / "run").exists()


async def test_a_question_that_a_stop_has_answered_is_not_asked() -> None:
    moving = MovingJob()
    answers: list[bool] = []
    async with running() as (pilot, app):
        app.start_job(moving.job())
        await asyncio.to_thread(moving.began.wait, WAIT_S)
        await pilot.press("escape")
        app.ask_before_motion("the first motion", answers.append)
        assert not isinstance(app.screen, MotionQuestion)
        await pilot.press("x")
        await ended(pilot, app)


def test_values_that_no_version_stores_are_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def damaged(profile_path: Path, profile: object, folder: Path) -> Workspace:
        raise ValueError("stop 3: not a number\nwith more lines")

    monkeypatch.setattr("cellapp.interfaces.tui.workspace._with_run", damaged)
    found = load_workspace(PROFILES / "twin.yaml", Path("logs/old"))
    assert found.problem == "logs/old holds values that this cellapp cannot read (stop 3: not a number)"
    assert found.folder is None
    assert found.profile is not None


TWIN = Path("profiles/twin.yaml")
EDITOR = """\
import pathlib, sys
path = pathlib.Path(sys.argv[-1])
path.write_text(path.read_text("utf-8").replace(*sys.argv[1:3]), "utf-8")
"""
WAITING_EDITOR = """\
import sys, termios
at = termios.tcgetattr(0)
at[3] &= ~termios.ICANON
termios.tcsetattr(0, termios.TCSANOW, at)
print("EDITING", sys.argv[1], flush=True)
try:
    while sys.stdin.read(1) != "w":
        pass
except KeyboardInterrupt:
    sys.exit("INTERRUPTED")
"""


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellApp:
    """The application in a folder with the twin; no editor is named."""
    monkeypatch.chdir(tmp_path)
    for name in ("EDITOR", "VISUAL"):
        monkeypatch.delenv(name, raising=False)
    copy_starter("twin", Path("profiles"))
    return CellApp(Path("profiles"))


def edits(cell: CellApp, monkeypatch: pytest.MonkeyPatch, before: str, after: str) -> None:
    """Name an editor that replaces a text of the file, in a terminal that can be lent."""
    Path("editor.py").write_text(EDITOR, "utf-8")
    monkeypatch.setenv("EDITOR", f"'{sys.executable}' editor.py '{before}' '{after}'")
    lent: list[str] = []

    @contextlib.contextmanager
    def lend() -> Iterator[None]:
        lent.append("lent")
        yield

    monkeypatch.setattr(cell, "lend_terminal", lend)


def said(cell: CellApp) -> list[str]:
    """The lines of the tab Profile."""
    return [str(one.render()) for one in cell.day_screen.query("#tab-profile PartsView Static").results(Static)]


@pytest.mark.parametrize("size", [SIZES[0], SIZES[1]])
async def test_what_is_wrong_is_listed_edited_and_checked_again(
    cell: CellApp, monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]
) -> None:
    text = TWIN.read_text("utf-8")
    TWIN.write_text(text.replace("\nplan:", "\nseed: 2\nplant_: {}\nplan:").replace("seed: 1", "seed: one", 1), "utf-8")
    edits(cell, monkeypatch, "plant_: {}", "")
    async with cell.run_test(size=size) as pilot:
        await until(pilot, lambda: all("twin.yaml:" in words for words in said(cell)), "the problems")
        assert cell.day_screen.query_one(TabbedContent).active == "tab-profile"
        await shows(pilot, "u edits it")
        TWIN.write_text(text.replace("\nplan:", "\nplant_: {}\nplan:"), "utf-8")
        await pilot.press("u")
        await opened(pilot, cell)
        assert cell.workspace.problem == ""
        edits(cell, monkeypatch, "name: twin", "nam: twin")
        await pilot.press("u")
        await until(pilot, lambda: any("did you mean" in words for words in said(cell)), "the new problem")


async def test_where_no_editor_can_be_opened_the_path_is_said(cell: CellApp, monkeypatch: pytest.MonkeyPatch) -> None:
    async with cell.run_test(size=SMALL) as pilot:
        await opened(pilot, cell)
        await pilot.press("u")
        await tells(pilot, f"Edit {TWIN.resolve()} in another window (EDITOR names no editor)")
        monkeypatch.setenv("EDITOR", "vi")  # but this terminal is none
        await pilot.press("u")
        await tells(pilot, "this terminal cannot be lent to an editor")
        edits(cell, monkeypatch, "a", "b")
        monkeypatch.setenv("VISUAL", "no-such-editor-of-cellapp")
        await pilot.press("u")
        await tells(pilot, "'no-such-editor-of-cellapp' cannot be started")


async def test_an_edited_profile_is_read_again_by_enter(cell: CellApp) -> None:
    async with cell.run_test(size=SMALL) as pilot:
        await opened(pilot, cell)
        TWIN.write_text(TWIN.read_text("utf-8").replace("\nname: twin\n", "\nname: other\n"), "utf-8")
        await pilot.press("enter")
        await until(pilot, lambda: cell.workspace.profile.name == "other", "the edited profile")  # type: ignore[union-attr]


async def test_no_profile_is_edited_while_a_job_runs(cell: CellApp, monkeypatch: pytest.MonkeyPatch) -> None:
    held = HeldJob()
    edits(cell, monkeypatch, "name: twin", "name: edited")
    async with cell.run_test(size=SMALL) as pilot:
        await opened(pilot, cell)
        cell.start_job(held.job())
        await pilot.press("u")
        await tells(pilot, "STOP must stay at hand")
        held.go_on.set()
        await ended(pilot, cell)
    assert load_profile(TWIN).name == "twin"


async def test_the_first_start_writes_a_profile_that_explains_its_keys(
    cell: CellApp, monkeypatch: pytest.MonkeyPatch
) -> None:
    TWIN.unlink()
    edits(cell, monkeypatch, "name: ur10-ur5", "name: hall-3")
    async with cell.run_test(size=SMALL) as pilot:
        await until(pilot, lambda: isinstance(cell.screen, Welcome), "the question")
        await pilot.press("w")
        await until(pilot, lambda: cell.workspace.profile is not None, "the profile")
    assert load_profile(Path("profiles/my-cell.yaml")).name == "hall-3"


@pytest.mark.waits
@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminal")
def test_an_editor_has_the_terminal_and_the_application_has_it_again(tmp_path: Path) -> None:
    copy_starter("twin", tmp_path / "profiles")
    (tmp_path / "editor.py").write_text(WAITING_EDITOR, "utf-8")
    command = [sys.executable, "-m", "cellapp"]
    terminal = Terminal(command, tmp_path, EDITOR=f"'{sys.executable}' editor.py", VISUAL="")
    try:
        terminal.until(lambda shown: "Edit profile" in shown and "twin.yaml is open" in shown, "the screen", WAIT_S)
        terminal.send("u")
        terminal.until(lambda shown: "EDITING" in shown, "the editor", WAIT_S)
        terminal.send("\x03")  # ignored by both: an editor does with it what it likes
        terminal.send("w")
        terminal.until(lambda shown: "Edit profile" in shown and "EDITING" not in shown, "the screen again", WAIT_S)
        terminal.send("q")
        assert terminal.process.wait(WAIT_S) == 0
    finally:
        terminal.close()
