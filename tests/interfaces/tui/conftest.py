"""Tests of the terminal application run in a folder of their own and wait for no animation."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.interfaces.tui.idle import wait_for_idle


@pytest.fixture(autouse=True)
def _surroundings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("textual.pilot.wait_for_idle", wait_for_idle)
    monkeypatch.setattr("textual.app.wait_for_idle", wait_for_idle)
    monkeypatch.setattr("textual.constants.TEXTUAL_ANIMATIONS", "none")
    # sets aside for good what is there: right for one application a process, of hundreds it keeps gigabytes
    monkeypatch.setattr("cellapp.interfaces.tui.app.gc", SimpleNamespace(collect=int, freeze=int))
    monkeypatch.chdir(tmp_path)  # runs go to logs in the working directory
