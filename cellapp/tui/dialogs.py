"""Questions over the screen. The keys that stop and abort a run work over them, too: the application has them first."""

from __future__ import annotations

from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.screen import ModalScreen
from textual.widgets import Button, Input, Static

from cellapp.tui.widgets import helped


class LeaveScreen(ModalScreen[bool]):
    """Ask whether to stop a run in order to quit."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "dismiss(True)", "Stop and quit"),
        Binding("n,escape", "dismiss(False)", "Continue"),
        Binding("left,right", "app.focus_next", show=False),
    ]

    def compose(self) -> ComposeResult:
        with Vertical(id="question"):
            yield Static("A run is in progress. Brake all arms, end the run and quit?", markup=False)
            with Horizontal(id="answers"):
                yield helped(Button("Continue (n)", id="stay", compact=True))
                yield helped(Button("Stop and quit (y)", id="leave", variant="error", compact=True))

    @on(Button.Pressed)
    def answer(self, event: Button.Pressed) -> None:
        """Close the question with the answer."""
        event.stop()
        self.dismiss(event.button.id == "leave")


class ConfirmScreen(ModalScreen[bool]):
    """Show the first motion of real arms in words; a person types the profile's name to allow it.

    Parameters
    ----------
    words : str
        The first motion.
    name : str
        What is to be typed.
    """

    def __init__(self, words: str, name: str) -> None:
        super().__init__()
        self._words, self._profile_name = words, name

    def compose(self) -> ComposeResult:
        with Vertical(id="question"):
            yield Static("REAL ARMS WILL MOVE. Is the cell clear?", markup=False, classes="title")
            yield Static(self._words, markup=False)
            yield Static(f"Type '{self._profile_name}' and Enter to let them move.", markup=False, id="asked")
            yield helped(Input(id="name", compact=True))
            with Horizontal(id="answers"):
                yield helped(Button("Do not move (Esc)", id="refuse", variant="error", compact=True))

    @on(Input.Submitted)
    def check_name(self, event: Input.Submitted) -> None:
        """Allow the motion if the name is right, else ask again."""
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
