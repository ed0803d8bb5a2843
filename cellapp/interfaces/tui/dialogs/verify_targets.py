"""Ask before targets are driven to and measured, and how often each is corrected by measuring."""

from __future__ import annotations

from collections.abc import Sequence

from textual.app import ComposeResult
from textual.widgets import Input, Static

from cellapp.interfaces.tui.dialogs.question import Answer, AnswerQuestion

MOST_ROUNDS = 20
"""As ``cellapp.commands.push.run`` has it, which loads more than a dialog needs."""


class VerifyTargets(AnswerQuestion[int]):
    """Returns the number of corrections, 0 for the model alone; None where the dialog is closed or answered with no.

    Parameters
    ----------
    text : str
        What a person must know to answer.
    answers : sequence of Answer
        "no" closes; any other begins. The first one has the focus.
    """

    DEFAULT_CSS = """
    VerifyTargets #iterate { width: 12; }
    """

    def __init__(self, text: str, answers: Sequence[Answer]) -> None:
        super().__init__("Push and verify?", text, answers)

    def fields(self) -> ComposeResult:
        """How often each target is corrected."""
        yield Static(f"Corrections of each target by measuring it, 0 to {MOST_ROUNDS}:", markup=False)
        yield Input("0", id="iterate", compact=True, restrict="[0-9]{0,2}", select_on_focus=True)

    def action_answer(self, value: str) -> None:
        """Close with an answer; with a number that is too large, say so."""
        text = self.query_one("#iterate", Input).value or "0"
        if value == "no":
            self.dismiss(None)
        elif int(text) <= MOST_ROUNDS:
            self.dismiss(int(text))
        else:
            self.explain(f"Type a number from 0 to {MOST_ROUNDS}.")
