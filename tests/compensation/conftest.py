"""One simulated run with its effects found, for all tests of this folder."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from cellapp.model import CellModel
from cellapp.run import RunFile
from cellapp.run.stages import CALIBRATION_FILE


@pytest.fixture(scope="session")
def run(finished_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunFile]:
    folder = tmp_path_factory.mktemp("compensation") / "run"
    shutil.copytree(finished_run, folder)
    with RunFile.open(folder, write=True) as opened:
        yield opened


@pytest.fixture(scope="session")
def model(run: RunFile) -> CellModel:
    return CellModel.load(run.folder / CALIBRATION_FILE)
