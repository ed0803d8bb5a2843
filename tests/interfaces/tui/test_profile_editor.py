"""Editing a profile in one's own editor: problems stand line by line, the profile is checked again on return."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from textual.widgets import DataTable, TabbedContent

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.starters import copy_starter
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.first_run import Welcome
from tests.interfaces.tui.pilot import SIZES, SMALL, HeldJob, ended, opened, shows, tells, until
from tests.interfaces.tui.terminal import Terminal
from tests.waiting import WAIT_S

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
def app(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellApp:
    """The application in a folder with the twin; no editor is named."""
    monkeypatch.chdir(tmp_path)
    for name in ("EDITOR", "VISUAL"):
        monkeypatch.delenv(name, raising=False)
    copy_starter("twin", Path("profiles"))
    return CellApp(Path("profiles"))


def edits(app: CellApp, monkeypatch: pytest.MonkeyPatch, before: str, after: str) -> None:
    """Name an editor that replaces a text of the file, in a terminal that can be lent."""
    Path("editor.py").write_text(EDITOR, "utf-8")
    monkeypatch.setenv("EDITOR", f"'{sys.executable}' editor.py '{before}' '{after}'")
    lent: list[str] = []

    @contextlib.contextmanager
    def lend() -> Iterator[None]:
        lent.append("lent")
        yield

    monkeypatch.setattr(app, "lend_terminal", lend)


def rows(app: CellApp) -> list[list[str]]:
    table = app.day_screen.query_one("#cell-words", DataTable)
    return [[str(cell) for cell in table.get_row_at(row)] for row in range(table.row_count)]


@pytest.mark.parametrize("size", [SIZES[0], SIZES[1]])
async def test_what_is_wrong_is_listed_edited_and_checked_again(
    app: CellApp, monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]
) -> None:
    text = TWIN.read_text("utf-8")
    TWIN.write_text(text.replace("\nplan:", "\nseed: 2\nplant_: {}\nplan:").replace("seed: 1", "seed: one", 1), "utf-8")
    edits(app, monkeypatch, "plant_: {}", "")
    async with app.run_test(size=size) as pilot:
        await until(pilot, lambda: len(rows(app)) > 0 and "twin.yaml:" in rows(app)[0][0], "the problems")
        assert app.day_screen.query_one("#cell-tabs", TabbedContent).active == "tab-profile"
        assert all(where.startswith("twin.yaml:") for where, _ in rows(app))
        await shows(pilot, "u edits it")
        TWIN.write_text(text.replace("\nplan:", "\nplant_: {}\nplan:"), "utf-8")
        await pilot.press("u")
        await opened(pilot, app)
        assert app.workspace.problem == ""
        edits(app, monkeypatch, "name: twin", "nam: twin")
        await pilot.press("u")
        await until(pilot, lambda: any("did you mean" in words for _, words in rows(app)), "the new problem")


async def test_where_no_editor_can_be_opened_the_path_is_said(app: CellApp, monkeypatch: pytest.MonkeyPatch) -> None:
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        await pilot.press("u")
        await tells(pilot, f"Edit {TWIN.resolve()} in another window (EDITOR names no editor)")
        monkeypatch.setenv("EDITOR", "vi")  # but this terminal is none
        await pilot.press("u")
        await tells(pilot, "this terminal cannot be lent to an editor")
        edits(app, monkeypatch, "a", "b")
        monkeypatch.setenv("VISUAL", "no-such-editor-of-cellapp")
        await pilot.press("u")
        await tells(pilot, "'no-such-editor-of-cellapp' cannot be started")


async def test_an_edited_profile_is_read_again_by_enter(app: CellApp) -> None:
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        TWIN.write_text(TWIN.read_text("utf-8").replace("\nname: twin\n", "\nname: other\n"), "utf-8")
        await pilot.press("enter")
        await until(pilot, lambda: app.workspace.profile.name == "other", "the edited profile")  # type: ignore[union-attr]


async def test_no_profile_is_edited_while_a_job_runs(app: CellApp, monkeypatch: pytest.MonkeyPatch) -> None:
    held = HeldJob()
    edits(app, monkeypatch, "name: twin", "name: edited")
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.start_job(held.job())
        await pilot.press("u")
        await tells(pilot, "STOP must stay at hand")
        held.go_on.set()
        await ended(pilot, app)
    assert load_profile(TWIN).name == "twin"


async def test_the_first_start_writes_a_profile_that_explains_its_keys(
    app: CellApp, monkeypatch: pytest.MonkeyPatch
) -> None:
    TWIN.unlink()
    edits(app, monkeypatch, "name: ur10-ur5", "name: hall-3")
    async with app.run_test(size=SMALL) as pilot:
        await until(pilot, lambda: isinstance(app.screen, Welcome), "the question")
        await pilot.press("w")
        await until(pilot, lambda: app.workspace.profile is not None, "the profile")
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
