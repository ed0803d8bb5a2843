"""The screen Runs."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.widgets import Static

from cellapp.tui.screens.base import DayScreen
from cellapp.tui.workspace import Step


class RunsScreen(DayScreen):
    """Placeholder."""

    STEP: ClassVar[Step] = "runs"

    def body(self) -> ComposeResult:
        yield Static("Runs", markup=False)
