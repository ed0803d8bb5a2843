"""The screen Collect."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.widgets import Static

from cellapp.tui.screens.base import DayScreen
from cellapp.tui.workspace import Step


class CollectScreen(DayScreen):
    """Placeholder."""

    STEP: ClassVar[Step] = "collect"

    def body(self) -> ComposeResult:
        yield Static("Collect", markup=False)
