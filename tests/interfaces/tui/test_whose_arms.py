"""Header and questions speak of the arms that a job moves, whatever is or was open besides."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

import pytest

from cellapp.cell.profile import load_profile
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.progress import ignore
from cellapp.interfaces.tui import work
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.program import MotionQuestion
from cellapp.interfaces.tui.dialogs.question import Choice, Reading
from cellapp.interfaces.tui.host import WorkspaceLoaded
from cellapp.interfaces.tui.jobs import MotionAsked
from cellapp.interfaces.tui.workspace import Workspace, load_workspace
from tests.interfaces.tui.pilot import PROFILES, SMALL, HeldJob, MovingJob, ended, opened, shown_text, until
from tests.waiting import WAIT_S

pytestmark = pytest.mark.fast

REAL = PROFILES / "ur10-ur5.yaml"


def beside_a_simulated_run(app: CellApp) -> Workspace:
    """A simulated run is open, and the profile that is chosen is that of real arms."""
    return Workspace(REAL, app.workspace.profile, Path("logs/simulated"), beside_run=load_profile(REAL))


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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
