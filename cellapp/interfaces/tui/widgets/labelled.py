"""A dialog field with its label."""

from __future__ import annotations

from collections.abc import Sequence

from textual.containers import Horizontal
from textual.content import Content
from textual.suggester import SuggestFromList
from textual.widget import Widget
from textual.widgets import Checkbox, Input, Static


class Labelled(Horizontal):
    """One line: a label and a field."""

    DEFAULT_CSS = """
    Labelled { height: 1; }
    Labelled Static { width: 20; }
    Labelled Input { width: 1fr; }
    """

    def __init__(self, label: str, field: Widget) -> None:
        super().__init__(Static(label, markup=False), field)


class Box(Checkbox):
    """A check box that is empty until it is ticked, so that its state is visible without colours."""

    def render(self) -> Content:
        """Return the mark and the label."""
        self.BUTTON_INNER = "X" if self.value else " "
        return super().render()


def text_field(label: str, name: str, text: str = "", hint: str = "", *, choices: Sequence[str] = ()) -> Labelled:
    """Return a text field with its label.

    Parameters
    ----------
    label, name : str
        Text before the field; its id.
    text, hint : str
        Initial text; text that is shown while the field is empty.
    choices : sequence of str
        Texts that the right arrow completes.
    """
    suggester = SuggestFromList(choices) if choices else None
    return Labelled(label, Input(text, id=name, compact=True, placeholder=hint, suggester=suggester))
