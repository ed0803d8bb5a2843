"""Ask for a number."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.widgets import Button, Input, Static

from cellapp.interfaces.tui.dialogs.question import FieldsQuestion


class CountQuestion(FieldsQuestion[int]):
    """How many. Returns the number; None where the dialog is closed.

    Parameters
    ----------
    title, text : str
        What is asked, and what a person must know to answer it.
    proposed, most : int
        What it begins with, and the largest number.
    """

    def __init__(self, title: str, text: str, proposed: int, most: int) -> None:
        super().__init__()
        self._title, self._text, self._proposed, self._most = title, text, proposed, most

    def body(self) -> ComposeResult:
        yield Static(self._title, classes="title", markup=False)
        yield Static(self._text, classes="text", markup=False)
        yield Input(str(self._proposed), id="count", compact=True)
        yield Static(f"Enter takes the number, {self.closing_key} closes.", id="why", classes="text", markup=False)
        with Horizontal(classes="answers"):
            yield Button("Take", id="take", variant="success", compact=True)
            yield Button("Close", id="close", compact=True)

    def on_mount(self) -> None:
        """Begin with the field."""
        self.query_one("#count").focus()

    def action_send(self) -> None:
        """Close with the number, if it is one that was asked for."""
        text = self.typed("count")
        if text.isascii() and text.isdigit() and 1 <= int(text[:10]) <= self._most:
            self.dismiss(int(text))
        else:
            self.explain(f"Type a whole number from 1 to {self._most}.")
