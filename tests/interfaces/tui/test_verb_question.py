"""Dialogs that are made from records of verbs, without a run: where they begin, what Enter does, what they return."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.widgets import Input, OptionList

from cellapp.commands.correct import VERB as CORRECT
from cellapp.commands.correct import CorrectRequest
from cellapp.commands.export.request import ExportRequest
from cellapp.commands.record import Request
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.question import Answer
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.offers import WRITE
from cellapp.interfaces.tui.screens.calibrate import ExportArms
from tests.commands.test_record import VERB, ToyRequest
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened, shown_text, until

pytestmark = pytest.mark.fast
GIVEN = {"folder": Path("day"), "program": Path("old.script")}


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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
