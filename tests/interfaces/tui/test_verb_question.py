"""Dialogs that are made from records of verbs, without a run: where they begin, what Enter does, what they return."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from textual.screen import ModalScreen
from textual.widgets import Input, OptionList

from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.correct import VERB as CORRECT
from cellapp.commands.correct import CorrectRequest
from cellapp.commands.export.request import ExportRequest
from cellapp.commands.locate.request import LocateRequest
from cellapp.commands.record import Request
from cellapp.commands.report.result import read_results
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.question import Answer, Choice, Reading
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.offers import WRITE
from cellapp.interfaces.tui.screens.calibrate import ExportArms
from tests.commands.test_show import VERB, ToyRequest
from tests.handbook.screen_pictures import settle
from tests.interfaces.tui.pilot import PROFILES, SMALL, ended, log_text, opened, shown_text, until

GIVEN = {"folder": Path("day"), "program": Path("old.script")}


async def test_enter_in_a_field_sends_what_moves_nothing_and_the_first_empty_field_has_the_focus() -> None:
    app, answers = CellApp(PROFILES), list[Request | None]()
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        proposed, choices = {"out": Path("new.script")}, {"arm": ("left", "right")}
        app.push_screen(VerbQuestion(CORRECT, "", WRITE, GIVEN, proposed=proposed, choices=choices), answers.append)
        await until(pilot, lambda: isinstance(app.focused, Input), "the focus")
        assert app.focused is app.screen.query_one("#arm")
        assert app.screen.query_one("#arm", Input).placeholder == "left or right"
        text = shown_text(app)
        assert "Write (Ctrl+S)" in text
        assert "Close (F10)" in text
        await pilot.press(*"left", "enter")
        await until(pilot, lambda: bool(answers), "the answer")
    assert answers == [
        CorrectRequest(folder=Path("day"), program=Path("old.script"), out=Path("new.script"), arm="left")
    ]


async def test_a_format_proposes_its_file_and_what_is_typed_stays() -> None:
    app, answers = CellApp(PROFILES), list[Request | None]()
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.push_screen(ExportArms(Path("day"), ("left", "right"), WRITE), answers.append)
        await until(pilot, lambda: isinstance(app.focused, OptionList), "the focus")
        assert "Write (Ctrl+S)" in shown_text(app), "all of the dialog fits into the smallest terminal"
        await pilot.press("down", "down")
        field = app.screen.query_one("#out", Input)
        await until(pilot, lambda: field.value == str(Path("day") / "urdf.urdf"), "the text of the field")
        field.value = ""
        await pilot.press("ctrl+s")
        await until(pilot, lambda: app.focused is field, "the field of the file that is needed")
        field.value = "mine.urdf"
        await pilot.press("enter")
        await until(pilot, lambda: bool(answers), "the answer")
    assert answers == [ExportRequest(folder=Path("day"), form="urdf", out=Path("mine.urdf"))]


async def test_an_emptied_number_is_refused() -> None:
    answered: list[Request | None] = []
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        question = VerbQuestion(VERB, "", (Answer("begin", "Begin", "b"), Answer("no", "No", "n")), {})
        app.push_screen(question, answered.append)
        await until(pilot, lambda: "Begin" in shown_text(app), "the dialog")
        assert isinstance(app.focused, Input), "nothing moves: the first field has the focus"
        for name, text, says in (
            ("count", "", "how many: expected a whole number"),
            ("count", "2.5", "how many: expected a whole number"),
            ("count", "4", ""),
        ):
            question.query_one(f"#{name}", Input).value = text
            if says:
                question.action_answer("begin")
                await pilot.pause()
                assert says in str(question.query_one("#why").render())
        question.action_answer("begin")
        await pilot.pause()
    assert answered == [ToyRequest(count=4)]


# Nothing is done again without a question: a key that would repeat what a run holds asks first, and begins nothing.

DAY = Path("logs") / "day"
ASKED = {
    "plan a new run": ("2", "b"),
    "append stops": ("2", "plus"),
    "design the rest again": ("2", "r"),
    "calibrate": ("4", "b"),
    "calibrate with a prior": ("4", "i"),
    "search": ("5", "b"),
    "propose": ("5", "plus"),
    "locate": ("6", "l"),
    "check": ("7", "k"),
    "ISO 9283": ("7", "m"),
    "certificate": ("7", "e"),
    "report": ("7", "b"),
    "the whole day": ("1", "f5"),
}


async def test_each_key_that_repeats_what_a_run_holds_asks_first(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    before = (DAY / "run.sqlite").read_bytes()
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(DAY, PROFILES / "twin.yaml")
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        for what, (step, key) in ASKED.items():
            await pilot.press(step)
            await settle(pilot)
            await pilot.press(key)
            await until(pilot, lambda: isinstance(app.screen, ModalScreen), f"a question before: {what}")
            assert not app.jobs.running, what
            await pilot.press("escape")
            await until(pilot, lambda: not isinstance(app.screen, ModalScreen), f"no question any more: {what}")
            assert not app.jobs.running, f"{what}:\n{shown_text(app)}"
    assert (DAY / "run.sqlite").read_bytes() == before


async def test_without_the_file_of_a_profile_a_sentence_says_what_to_do(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(DAY)
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await pilot.press("2", "b")
        await until(pilot, lambda: "choose one on the screen Cell (key 1)" in app.message, "the sentence")


@pytest.mark.parametrize("key", ["4", "5"])
async def test_the_question_says_what_is_there_and_the_default_leaves_it(key: str, finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(DAY, PROFILES / "twin.yaml")
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await pilot.press(key, "b")
        await until(pilot, lambda: isinstance(app.screen, ModalScreen), "the question")
        assert "The run has a result that holds" in " ".join(shown_text(app).split())
        await pilot.press("enter")
        await until(pilot, lambda: not isinstance(app.screen, ModalScreen), "the screen")
        assert not app.jobs.running


# -- The tracker is located from the screen Targets, as the command does it --------------------------------------------


async def test_the_tracker_is_located_and_a_wrong_pose_is_refused(finished_copy: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(finished_copy)
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await pilot.press("6")
        await until(pilot, lambda: app.day_screen.STEP == "targets", "the screen")
        await pilot.press("l")
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the question")
        assert "Not now" in shown_text(app), "all of the dialog fits into the smallest terminal"
        assert app.screen.query_one("#points", Input).value == str(LocateRequest(folder=finished_copy).points)
        app.screen.query_one("#points", Input).value = "many"
        await pilot.press("b")
        await until(pilot, lambda: "points: expected a whole number" in shown_text(app), "what is wrong")
        app.screen.query_one("#points", Input).value = "4"
        app.screen.query_one("#tracker-pose", Input).value = "1,2"
        await pilot.press("b")
        await until(pilot, lambda: "expected x,y,z,roll,pitch,yaw" in app.message, "the refusal")
        await pilot.press("l")
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the question again")
        app.screen.query_one("#tracker-pose", Input).value = "4.1,0.1,0.6,0,0,183"
        app.screen.query_one("#simulated-pose", Input).value = "4.11,0.09,0.61,0,0,183.2"
        await pilot.press("b")
        await until(pilot, lambda: isinstance(app.screen, Reading), "where the tracker stands")
        assert "it stands at" in shown_text(app)
        await ended(pilot, app)
        assert "locate: done; the tracker was located" in log_text(app)
    with RunFile.open(finished_copy) as run:
        found = read_results(run).locate
    assert found is not None
    assert found.tracker_pose.position == pytest.approx((4.11, 0.09, 0.61), abs=0.5e-3)


# -- An arm is calibrated with an earlier run as prior from the screen Calibrate, as the command does ------------------

DAY_OF_PRIOR, EARLIER = Path("logs") / "day", Path("logs") / "earlier"


async def test_the_earlier_run_is_chosen_and_shown(finished_run: Path) -> None:
    shutil.copytree(finished_run, EARLIER)
    with RunFile.open(EARLIER) as before, RunFile.create(DAY_OF_PRIOR, before.profile) as run:
        for name in run.profile.arms:
            readings = before.readings(name)
            moved = readings.p_M + np.array([0.01, 0.02, 0.03])  # the same stops, seen from another place
            run.add_readings(name, replace(readings, p_M=moved))
        calibrate_run(run)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(DAY_OF_PRIOR)
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await pilot.press("4")
        await until(pilot, lambda: app.day_screen.STEP == "calibrate", "the screen")
        await pilot.press("i")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question, as the calibration holds")
        assert "Calibrate again, with a prior?" in shown_text(app)
        await pilot.press("n", "i")
        await until(pilot, lambda: isinstance(app.screen, Choice), "the question again")
        await pilot.press("b")
        await until(pilot, lambda: isinstance(app.screen, FilePicker), "the dialog")
        app.screen.query_one("#path", Input).value = str(EARLIER / "run.sqlite")
        await pilot.press("enter")
        await ended(pilot, app)
    with RunFile.open(DAY_OF_PRIOR) as run:
        result = read_results(run).calibrate
    assert result is not None
    assert all(arm.prior is not None and arm.prior.stage == "discover" for arm in result.arms.values())
