"""Tests of the terminal application run in a folder of their own and wait for no animation."""

from __future__ import annotations

from pathlib import Path

import pytest

IDLE_S = 0.005
"""The pilot goes on when the application has left the processor idle for this long. Textual waits for 20 ms, twice a
key, which was half of the time of these tests; whatever comes later, the tests wait for by its condition."""


@pytest.fixture(autouse=True)
def _surroundings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("textual.constants.TEXTUAL_ANIMATIONS", "none")
    monkeypatch.setattr("textual._wait.SLEEP_GRANULARITY", IDLE_S)
    monkeypatch.setattr("textual._wait.SLEEP_IDLE", IDLE_S / 5.0)
    monkeypatch.chdir(tmp_path)  # runs go to logs in the working directory
