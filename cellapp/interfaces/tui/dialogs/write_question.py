"""A dialog of fields that Enter, a button or Ctrl+S sends off."""

from __future__ import annotations

from typing import ClassVar

from textual.binding import Binding, BindingType

from cellapp.interfaces.tui.dialogs.question import A, FieldsQuestion


class WriteQuestion(FieldsQuestion[A]):
    """A question whose answer is what is written."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("ctrl+s", "send", "Write", priority=True)]
