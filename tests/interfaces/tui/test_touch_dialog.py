"""Touches of sockets are recorded from the palette: a dialog takes the socket's name, and asks for the next one."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Checkbox, Input

from cellapp.cell.run import RunFile
from cellapp.commands.doctor.request import VERB as DOCTOR
from cellapp.interfaces.tui import offers
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.palette import possible_commands
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened, shown_text, shows, until

TWIN = PROFILES / "twin.yaml"


async def asked_for_the_twin(pilot: Pilot[None], app: CellApp, verb: str, word: str) -> None:
    """Open the twin, and the dialog of a verb from the palette; ``word`` stands in it."""
    await opened(pilot, app)
    app.open_profile(TWIN)
    await until(pilot, lambda: app.workspace.profile_path == TWIN, "the twin")
    {one.title: one for one in possible_commands(app, app.day_screen)}[f"cellapp {verb}"].callback()
    await until(pilot, lambda: isinstance(app.screen, VerbQuestion) and word in shown_text(app), "the dialog")


def begin(app: CellApp) -> None:
    """Answer the dialog as its button does."""
    question = app.screen
    assert isinstance(question, VerbQuestion)
    question.action_answer("begin")


async def test_a_name_and_enter_record_and_the_next_one_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(offers, "new_folder", lambda profile: tmp_path / "touched")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await asked_for_the_twin(pilot, app, "touch", "socket")
        await shows(pilot, "Close")  # all of the dialog fits into the smallest terminal
        app.screen.query_one("#point", Input).value = "front_0"
        await pilot.press("ctrl+s")
        await until(pilot, lambda: "say which arm is led" in app.message, "the refusal")
        offers.offer_touch(app.day_screen)
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion) and "socket" in shown_text(app), "it again")
        app.screen.query_one("#arm", Input).value = "left"
        app.screen.query_one("#point", Input).value = "front_0"
        await pilot.press("ctrl+s")
        await until(pilot, lambda: "1 touch recorded" in shown_text(app), "the touch, and the dialog for the next one")
        assert app.screen.query_one("#point", Input).value == "front_0"
        assert "Close" in shown_text(app)
        app.screen.query_one("#undo", Checkbox).value = True
        app.screen.query_one("#point", Input).value = ""
        await pilot.press("ctrl+s")
        await until(pilot, lambda: "was taken back" in shown_text(app), "the dialog after that")
        await pilot.press("f10")
        await until(pilot, lambda: not isinstance(app.screen, VerbQuestion), "the end")
    with RunFile.open(tmp_path / "touched") as run:
        assert not run.arms()


async def test_the_palette_rehearses_the_profile_that_is_open() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await asked_for_the_twin(pilot, app, "rehearse", "step")
        app.screen.query_one("#rung", Input).value = "both-arms"
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the question")
        begin(app)
        await until(pilot, lambda: "has no controller" in app.message, "the refusal of simulated arms")


async def test_the_palette_asks_the_doctor_for_a_report_to_the_authors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await asked_for_the_twin(pilot, app, "doctor", "report in file")
        app.screen.query_one("#bundle", Input).value = "report.zip"
        app.screen.query_one("#run-folder", Input).value = "no-run"
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the question")
        begin(app)
        await until(pilot, lambda: "--run no-run: there is no run" in app.message, "the refusal")
        assert not Path("report.zip").exists()
        offers.offer_verb_of_profile(app.day_screen, DOCTOR)
        await until(
            pilot, lambda: isinstance(app.screen, VerbQuestion) and "report in file" in shown_text(app), "it again"
        )
        app.screen.query_one("#bundle", Input).value = "report.zip"
        begin(app)
        await until(pilot, lambda: "written: report.zip" in shown_text(app), "what the doctor found")
    assert zipfile.is_zipfile("report.zip")
