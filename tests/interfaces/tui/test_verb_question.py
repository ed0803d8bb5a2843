"""A dialog that is made from the record of a verb: secrets, numbers, and what it begins with."""

from __future__ import annotations

from pydantic import SecretStr
from textual.widgets import Input

from cellapp.commands.record import Request
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.question import Answer
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from tests.commands.test_record import VERB, ToyRequest
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened, shown_text, until

WORD = "correct horse"


async def test_a_new_secret_is_typed_twice_and_an_emptied_number_is_refused() -> None:
    answered: list[Request | None] = []
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        question = VerbQuestion(VERB, "", (Answer("begin", "Begin", "b"), Answer("no", "No", "n")), {})
        app.push_screen(question, answered.append)
        await until(pilot, lambda: "Begin" in shown_text(app), "the dialog")
        assert isinstance(app.focused, Input), "nothing moves: the first field has the focus"
        for name, text, says in (
            ("word", WORD, "The two of word differ"),
            ("word-again", WORD, ""),
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
    assert answered == [ToyRequest(count=4, word=SecretStr(WORD))]
    assert WORD not in repr(answered)
