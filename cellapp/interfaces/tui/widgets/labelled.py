"""A field of a dialog with its name before it."""

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
    """A box that is empty until it is ticked: without colours, too, one sees which it is."""

    def render(self) -> Content:
        """The mark, then the label."""
        self.BUTTON_INNER = "X" if self.value else " "
        return super().render()


def text_field(
    label: str, name: str, text: str = "", hint: str = "", *, choices: Sequence[str] = (), hidden: bool = False
) -> Labelled:
    """A field for a text with its label.

    Parameters
    ----------
    label, name : str
        What stands before the field; its id.
    text, hint : str
        What it begins with, and what it shows while it is empty.
    choices : sequence of str
        Texts that the right arrow completes.
    hidden : bool
        Whether the letters are shown as dots.
    """
    suggester = SuggestFromList(choices) if choices else None
    return Labelled(label, Input(text, id=name, compact=True, placeholder=hint, suggester=suggester, password=hidden))
