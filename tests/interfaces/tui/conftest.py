"""Tests of the terminal application run in a folder of their own, wait for no animation, and draw what is looked at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from textual._compositor import Compositor

from tests.interfaces.tui.idle import wait_for_idle

_update = Compositor.render_update


@pytest.fixture(autouse=True)
def _surroundings(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("textual.pilot.wait_for_idle", wait_for_idle)
    monkeypatch.setattr("textual.app.wait_for_idle", wait_for_idle)
    monkeypatch.setattr("textual.constants.TEXTUAL_ANIMATIONS", "none")
    if "drawn" not in request.fixturenames:
        monkeypatch.setattr(Compositor, "render_update", _only_when_whole)
    monkeypatch.chdir(tmp_path)  # runs go to logs in the working directory


@pytest.fixture
def drawn() -> None:
    """For a test of drawing itself: every change of the screen is drawn at once, as in a terminal."""


def _only_when_whole(self: Compositor, full: bool = False, **options: Any) -> Any:
    """Draw a whole screen, as for a picture; leave out the parts that changed: without a terminal nobody sees them, and
    they take a third of the time of a test. What a test looks at (``pilot.shown_text``) is drawn then."""
    if full:
        return _update(self, full, **options)
    self._dirty_regions.clear()
    return None
