"""The screen Plan."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.widgets import Static

from cellapp.tui.screens.base import DayScreen
from cellapp.tui.workspace import Step


class PlanScreen(DayScreen):
    """Placeholder."""

    STEP: ClassVar[Step] = "plan"

    def body(self) -> ComposeResult:
        yield Static("Plan", markup=False)
