"""Ask before targets are driven to and measured, and how often each is corrected by measuring."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.widgets import Button, Input, Static

from cellapp.tui.dialogs.question import Answer, Question

MOST_ROUNDS = 20
"""As ``cellapp.push_verb`` has it, which loads more than a dialog needs."""


class VerifyTargets(Question[int]):
    """Returns the number of corrections, 0 for the model alone; None where the dialog is closed or answered with no.

    Parameters
    ----------
    text : str
        What a person must know to answer.
    answers : sequence of Answer
        "no" closes; any other begins. The first one has the focus.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left,up", "app.focus_previous", show=False),
        Binding("right,down", "app.focus_next", show=False),
    ]
    DEFAULT_CSS = """
    VerifyTargets #iterate { width: 12; }
    """

    def __init__(self, text: str, answers: Sequence[Answer]) -> None:
        super().__init__()
        self._text, self._answers = text, tuple(answers)

    def body(self) -> ComposeResult:
        yield Static("Push and verify?", classes="title", markup=False)
        yield Static(self._text, classes="text", markup=False)
        yield Static(f"Corrections of each target by measuring it, 0 to {MOST_ROUNDS}:", markup=False)
        yield Input("0", id="iterate", compact=True, restrict="[0-9]{0,2}", select_on_focus=True)
        yield Static("", id="why", classes="text", markup=False)
        with Horizontal(classes="answers"):
            for answer in self._answers:
                label = f"{answer.label} ({answer.key})"
                yield Button(label, id=answer.value, variant=answer.variant, compact=True)

    def on_mount(self) -> None:
        """Let each answer be given by its key, over the field too: it takes digits only."""
        for answer in self._answers:
            self._bindings.bind(answer.key, f"answer('{answer.value}')", answer.label)
        self.query(Button).first().focus()

    def action_answer(self, value: str) -> None:
        """Close with an answer; with a number that is too large, say so."""
        text = self.query_one("#iterate", Input).value or "0"
        if value == "no":
            self.dismiss(None)
        elif int(text) <= MOST_ROUNDS:
            self.dismiss(int(text))
        else:
            self.query_one("#why", Static).update(f"Type a number from 0 to {MOST_ROUNDS}.")

    @on(Button.Pressed)
    def press(self, event: Button.Pressed) -> None:
        """Close with the answer of the button."""
        event.stop()
        self.action_answer(event.button.id or "")

    @on(Input.Submitted)
    def leave_field(self, event: Input.Submitted) -> None:
        """Enter in the field goes to the answers: nothing moves by it."""
        event.stop()
        self.query(Button).first().focus()
