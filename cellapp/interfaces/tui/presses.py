"""Presses of STOP that brake before the event loop gets them, and protection against misordered resume keys."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from textual.geometry import Region

from cellapp.interfaces.tui.messages import StopGiven

if TYPE_CHECKING:
    from cellapp.interfaces.tui.jobs import JobRunner

_RESUME_AFTER_S = 0.3
"""A resume key that is handled sooner than this after a STOP may have been pressed before it."""


class StopPresses:
    """Presses of STOP, handled in the thread that reads the terminal.

    Attributes
    ----------
    region : Region
        Position of STOP, on every screen and every dialog [cells].
    """

    def __init__(self, jobs: JobRunner) -> None:
        self._jobs = jobs
        self.region = Region()
        self._given = self._said = 0
        self._said_s = -_RESUME_AFTER_S

    def give(self) -> StopGiven | None:
        """Brake all arms now; return None and do nothing if no job runs. In the thread that read the press."""
        if not self._jobs.possible("stop"):
            return None
        control = self._jobs.control
        arms = control.has_brakes
        self._given += 1  # first: from now on an earlier key does not resume
        control.stop()
        return StopGiven(arms)

    def said(self) -> None:
        """Note that the screens have handled the oldest press."""
        self._said += 1
        self._said_s = time.monotonic()

    @property
    def just_given(self) -> bool:
        """Whether the key that is handled now may have been pressed before the last STOP."""
        return self._given != self._said or time.monotonic() < self._said_s + _RESUME_AFTER_S
