"""A form field on one line: its label, its text, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.suggester import SuggestFromList
from textual.widgets import Input, Label, Static

from cellapp.cell.profile.draft_fields import FormField


class FieldRow(Horizontal):
    """One field.

    Parameters
    ----------
    field_id : str
        As ``draft.Filled.id``.
    form : FormField
    text : str
        Initial text.
    choices : sequence of str
        Texts that the right arrow completes.
    begins : bool
        Whether a group of fields begins here.
    """

    DEFAULT_CSS = """
    FieldRow { height: 1; }
    FieldRow Label { width: 15; color: $text-muted; }
    FieldRow Input { width: 1fr; min-width: 24; }
    FieldRow .problem { width: auto; max-width: 45%; padding-left: 1; color: $text-error; text-wrap: nowrap; }
    FieldRow .problem { text-overflow: ellipsis; }
    FieldRow.begins { background: $panel; }
    FieldRow.wrong Label { color: $text-error; text-style: bold; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "app.focus_previous", show=False),
        Binding("down,enter", "app.focus_next", show=False),
    ]

    def __init__(
        self, field_id: str, form: FormField, text: str, choices: Sequence[str] = (), *, begins: bool = False
    ) -> None:
        super().__init__(classes="begins" if begins else "")
        self.field_id, self.form = field_id, form
        suggester = SuggestFromList(choices) if choices else None
        self.input = Input(text, placeholder=", ".join(choices), suggester=suggester, compact=True)
        self._problem = Static("", classes="problem", markup=False)

    def compose(self) -> ComposeResult:
        yield Label(self.form.label, markup=False)
        yield self.input
        yield self._problem

    def show_text(self, text: str) -> None:
        """Replace the text, as after an undo."""
        if self.input.value != text:
            self.input.value = text

    def show_problem(self, words: str) -> None:
        """Show what is wrong; empty if nothing is."""
        self.set_class(bool(words), "wrong")
        self._problem.update(f"◂ {words}" if words else "")
