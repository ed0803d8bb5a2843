"""A finished run, opened as a program of a user opens it."""

from __future__ import annotations

from pathlib import Path

import pytest

import cellapp


@pytest.fixture(scope="module")
def run(finished_run: Path) -> cellapp.Run:
    return cellapp.open_run(finished_run)
