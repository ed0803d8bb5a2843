"""The command palette, with STOP in its corner."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.command import CommandPalette

from cellapp.tui.widgets.stop import StopCorner


class Palette(CommandPalette):
    """Every action of the application by a few letters of its name."""

    def compose(self) -> ComposeResult:
        yield StopCorner()
        yield from super().compose()
