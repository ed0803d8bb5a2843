"""The command palette, with STOP in its corner."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.command import CommandPalette

from cellapp.tui.widgets.stop import StopCorner


class Palette(CommandPalette):
    """Every action of the application by a few letters of its name. F10 closes it, as all dialogs."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("f10", "escape", show=False)]

    def compose(self) -> ComposeResult:
        yield StopCorner()
        yield from super().compose()
