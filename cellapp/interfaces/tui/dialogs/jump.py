"""Letter labels on all focusable widgets: the letter jumps to its widget."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.events import Key
from textual.screen import ModalScreen, Screen
from textual.widget import Widget
from textual.widgets import Static

from cellapp.interfaces.tui.widgets.stop import StopCorner

LETTERS = "asdfghjklqwertyuiopzxcvbnm"


class Jump(ModalScreen[None]):
    """Press the letter of a widget to jump there; any other key closes.

    Parameters
    ----------
    screen : Screen
        The screen below, whose widgets are labelled.
    """

    DEFAULT_CSS = """
    Jump { background: $background 30%; }
    Jump .label { width: 3; height: 1; position: absolute; background: $accent; color: $text; text-style: bold; }
    """

    def __init__(self, screen: Screen[object]) -> None:
        super().__init__()
        places = [widget for widget in screen.focus_chain if widget.region.width > 0 and widget.region.height > 0]
        self._places: dict[str, Widget] = dict(zip(LETTERS, places))

    def compose(self) -> ComposeResult:
        yield StopCorner()
        for letter, widget in self._places.items():
            label = Static(f" {letter} ", classes="label", markup=False)
            label.absolute_offset = widget.region.offset
            yield label

    def on_key(self, event: Key) -> None:
        """Jump, or close."""
        event.stop()
        widget = self._places.get(event.character or "")
        self.dismiss(None)
        if widget is not None:
            widget.focus()
