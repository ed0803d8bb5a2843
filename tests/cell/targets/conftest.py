"""One simulated run with its effects found, and a witness of the cells that are opened, for this folder."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cellapp.cell.driving.cell import Cell, build_plant, open_cell
from cellapp.cell.run import RunFile
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.prediction import Command
from cellapp.commands.stages import CALIBRATION_FILE
from cellapp.ground.profile import Profile
from cellapp.robot.model import CellModel


@pytest.fixture(scope="session")
def run(finished_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunFile]:
    folder = tmp_path_factory.mktemp("compensation") / "run"
    shutil.copytree(finished_run, folder)
    with RunFile.open(folder, write=True) as opened:
        yield opened


@pytest.fixture(scope="session")
def model(run: RunFile) -> CellModel:
    return CellModel.load(run.folder / CALIBRATION_FILE)


@pytest.fixture(scope="module")
def commands(run: RunFile, model: CellModel, request: pytest.FixtureRequest) -> tuple[Command, ...]:
    """The commands of the module's ``TARGETS``."""
    return compensate(run.profile, model, request.module.TARGETS)


@pytest.fixture
def cells(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The cells that pushing opens, each with a witness of its clearances."""
    opened: list[Any] = []

    @contextmanager
    def watched(profile: Profile, **options: Any) -> Iterator[Cell]:
        with open_cell(profile, **options, plant=build_plant(profile, watch_clearance=True)) as cell:
            opened.append(cell)
            yield cell

    monkeypatch.setattr("cellapp.cell.driving.supervision.open_cell", watched)
    return opened
