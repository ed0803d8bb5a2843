"""Permission for the first motion of real arms."""

from __future__ import annotations

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.widgets import Button, Input, Static

from cellapp.interfaces.tui.dialogs.question import Question


class MotionQuestion(Question[bool]):
    """Show the first motion of real arms in words; a person types the profile's name to allow it.

    Parameters
    ----------
    words : str
        The first motion.
    name : str
        The name to type.
    """

    def __init__(self, words: str, name: str) -> None:
        super().__init__()
        self._words, self._profile_name = words, name

    def body(self) -> ComposeResult:
        yield Static("REAL ARMS WILL MOVE. Is the cell clear?", markup=False, classes="title danger")
        yield Static(self._words, markup=False, classes="text")
        yield Static(f"Type '{self._profile_name}' and Enter to let them move.", markup=False, id="asked")
        yield Input(id="name", compact=True)
        with Horizontal(classes="answers"):
            yield Button("Do not move (Esc)", id="refuse", variant="error", compact=True)

    def on_mount(self) -> None:
        """Focus the field."""
        self.query_one("#name").focus()

    @on(Input.Submitted)
    def check_name(self, event: Input.Submitted) -> None:
        """Allow the motion if the name is correct, else ask again."""
        event.stop()
        if event.value.strip() == self._profile_name:
            self.dismiss(True)
        else:
            self.query_one("#asked", Static).update(f"That is not '{self._profile_name}'. Type it, or press Escape.")

    @on(Button.Pressed)
    def refuse(self, event: Button.Pressed) -> None:
        """Close the question: nothing moves."""
        event.stop()
        self.dismiss(False)
