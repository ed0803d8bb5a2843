"""The screen Targets: a list that an editor changes; a push with a model that is out of date."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import DataTable, Input, Static

from cellapp.cell.targets.targets import load_targets
from cellapp.commands.push.request import PushRequest
from cellapp.commands.record import Verb
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.question import Choice
from cellapp.interfaces.tui.jobs import Job
from cellapp.interfaces.tui.workspace import Workspace
from tests.interfaces.tui.pilot import PROFILES, ended, running, shows, until
from tests.interfaces.tui.test_cell_screen import edits
from tests.twin import small_twin, write_few_targets

TWIN = PROFILES / "twin.yaml"
LISTED = load_targets(PROFILES / "targets" / "twin.yaml", small_twin())


def grid(app: CellApp) -> DataTable[object]:
    return app.day_screen.query_one("#grid", DataTable)


def heading(app: CellApp) -> str:
    return str(app.day_screen.query_one("#about-list", Static).content)


async def show_targets(pilot: Pilot[None], app: CellApp, run: Path | None, targets: Path | None = None) -> None:
    """Open a run, show the screen, wait for its list; then open another list if one is given."""
    if run is not None:
        app.open_run(run, TWIN)
        await until(pilot, lambda: app.workspace.folder == run, "the run")
    await pilot.press("6")
    await until(pilot, lambda: app.day_screen.STEP == "targets" and grid(app).row_count == len(LISTED), "the list")
    if targets is not None:
        await open_list(pilot, app, targets)
        await until(pilot, lambda: str(targets) in heading(app), "the other list")


async def open_list(pilot: Pilot[None], app: CellApp, path: Path) -> None:
    await pilot.press("o")
    await until(pilot, lambda: isinstance(app.screen, FilePicker), "the file picker")
    app.screen.query_one("#path", Input).value = str(path)
    await pilot.press("enter")
    await pilot.pause()


def asked(app: CellApp) -> str:
    """The text of the present question."""
    return str(app.screen.query_one(".text", Static).content)


@pytest.fixture
def few(tmp_path: Path) -> Path:
    """Three targets, the first with a tolerance that is met, the second with one that is not."""
    path = tmp_path / "few.yaml"
    write_few_targets(path)
    return path


async def test_a_model_that_is_out_of_date_is_used_only_if_that_is_said(
    finished_copy: Path, few: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[PushRequest] = []

    def job(verb: Verb, request: PushRequest) -> Job:
        started.append(request)
        return Job(verb.name, lambda control, ask: None)

    monkeypatch.setattr("cellapp.interfaces.tui.verb_jobs.verb_job", job)
    monkeypatch.setattr(Workspace, "stale", "'discover' is out of date (new readings)")
    async with running() as (pilot, app):
        await show_targets(pilot, app, finished_copy, few)
        for answer in ("enter", "u"):
            await pilot.press("P")
            await until(pilot, lambda: isinstance(app.screen, Choice), "the question")
            assert "'discover' is out of date (new readings)" in asked(app)
            await pilot.press(answer)
            await until(pilot, lambda: app.screen is app.day_screen, "the answer")
        await ended(pilot, app)
    (request,) = started
    assert request.targets == load_targets(few, small_twin())
    assert (request.verify, request.out_of_date) == (False, True)


async def test_a_list_is_edited_and_checked_again(tmp_path: Path, few: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async with running() as (pilot, app):
        await show_targets(pilot, app, None, few)
        monkeypatch.chdir(tmp_path)
        edits(app, monkeypatch, "left-02", "left-01")
        await pilot.press("u")
        await shows(pilot, "listed twice")
        assert grid(app).row_count == 3, "the list that was read before"
        edits(app, monkeypatch, "left-03", "third")
        few.write_text(few.read_text("utf-8").replace("left-01", "first", 1), "utf-8")
        await pilot.press("u")
        await shows(pilot, "third")
