"""Runs that the product made, once for all tests of the report; tests that change a run work on a copy."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.interfaces.page.page import page_text
from tests.interfaces.page.parsed_page import NOON, Page
from tests.interfaces.page.runs import EVENT, LEFT, NAME, RIGHT, fill, targets_of, twin_of, without_devices
from tests.made_once import made_once
from tests.verbs import push_run


@pytest.fixture(scope="session")
def whole_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the simulated cell with every result and with hostile names."""

    def make(folder: Path) -> None:
        with new_planned_run(twin_of(LEFT, RIGHT, NAME), folder) as run:
            run.log("warning", EVENT)
            collect_run(run)
            calibrate_run(run)
            discover_run(run)
            push_run(run, targets_of(LEFT, RIGHT), verify=True)

    return made_once(tmp_path_factory, "reported-run", make)


@pytest.fixture(scope="session")
def whole(whole_folder: Path) -> Iterator[RunFile]:
    """The run with every result, opened for reading."""
    with RunFile.open(whole_folder) as run:
        yield run


@pytest.fixture(scope="session")
def whole_text(whole: RunFile) -> str:
    return page_text(whole, NOON)


@pytest.fixture(scope="session")
def whole_page(whole_text: str) -> Page:
    return Page(whole_text)


@pytest.fixture(scope="session")
def calibrated_folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs without devices that are calibrated and no more: ``single`` of one arm, ``double`` and ``pair`` of two."""
    folder = tmp_path_factory.mktemp("calibrated")
    for name, arms in (("single", ["only"]), ("double", [LEFT, RIGHT]), ("pair", ["left", "right"])):
        with RunFile.create(folder / name, without_devices(*arms)) as run:
            fill(run)
            calibrate_run(run)
    return folder


@pytest.fixture(scope="session")
def single_text(calibrated_folders: Path) -> str:
    """The page of one arm that is calibrated and no more."""
    with RunFile.open(calibrated_folders / "single") as run:
        return page_text(run, NOON)


@pytest.fixture
def single(calibrated_folders: Path, tmp_path: Path) -> Iterator[RunFile]:
    """One arm without devices, calibrated and no more."""
    shutil.copytree(calibrated_folders / "single", tmp_path / "single")
    with RunFile.open(tmp_path / "single", write=True) as run:
        yield run


@pytest.fixture
def double(calibrated_folders: Path, tmp_path: Path) -> Iterator[RunFile]:
    """Two arms without devices, calibrated and no more."""
    shutil.copytree(calibrated_folders / "double", tmp_path / "double")
    with RunFile.open(tmp_path / "double", write=True) as run:
        yield run
