"""A dialog of fields that Enter, a button or Ctrl+S sends off."""

from __future__ import annotations

from typing import ClassVar

from textual import on
from textual.binding import Binding, BindingType
from textual.widgets import Button, Input

from cellapp.tui.dialogs.question import A, Question


class WriteQuestion(Question[A]):
    """A question whose answer is what is written. It has a button ``write`` and one that closes."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("ctrl+s", "write", "Write", priority=True)]

    @on(Input.Submitted)
    def submit(self, event: Input.Submitted) -> None:
        """Write with Enter in any field."""
        event.stop()
        self.action_write()

    @on(Button.Pressed)
    def press(self, event: Button.Pressed) -> None:
        """Write or close."""
        event.stop()
        if event.button.id == "write":
            self.action_write()
        else:
            self.dismiss(None)

    def action_write(self) -> None:
        """Close with the answer, if the fields are complete."""
        raise NotImplementedError
