"""A small run of the simulated cell, made once a session by the verbs themselves."""

from __future__ import annotations

import os

# One thread of linear algebra: most matrices here are small, and a second thread makes them slower on two cores.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from cellapp.collection.collect import collect_run
from cellapp.compensation.targets import load_targets
from cellapp.pipeline import calibrate_run, discover_run, new_planned_run, push_run
from tests.twin import PROFILES, finished_twin

FEW_TARGETS = 2
TESTS = Path(__file__).parent
ON_THE_WIRE = tuple(
    TESTS / place
    for place in (
        "commissioning",
        "drivers/arms",
        "drivers/emulators",
        "drivers/sensors",
        "drivers/trackers",
        "collection/test_controllers.py",
        "trials/test_storm.py",
        "tui/test_stop_on_the_wire.py",
    )
)
"""Tests with sockets, fixed addresses and real waits: one process does all of them, one after the other."""
GIVES_WAY = 5
"""Niceness of a process that computes: it gets a quarter of a core that both want."""


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Two processes for a run of all tests: one mostly waits for emulators, the other computes. None for a part."""
    return 2 if config.args_source == pytest.Config.ArgsSource.TESTPATHS else 0


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep a module's tests in one process, where they share fixtures, and all tests on the wire in the first one."""
    if not hasattr(config, "workerinput"):
        return
    items.sort(key=lambda item: not is_on_the_wire(item))
    for item in items:
        group = "on the wire" if is_on_the_wire(item) else item.path.relative_to(TESTS).as_posix()
        item.add_marker(pytest.mark.xdist_group(group))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let a process that computes give way to the one whose devices send heartbeats, which begins with those."""
    if hasattr(item.config, "workerinput") and hasattr(os, "nice") and not is_on_the_wire(item):
        os.nice(max(0, GIVES_WAY - os.nice(0)))


def is_on_the_wire(item: pytest.Item) -> bool:
    """Whether a test needs sockets, fixed addresses or real waits."""
    return any(item.path.is_relative_to(place) for place in ON_THE_WIRE)


# an example that takes long, on a busy computer, is no fault
settings.register_profile("cellapp", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("cellapp")


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run that was collected, calibrated, searched and verified at two targets. No test may write to it."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    with new_planned_run(finished_twin(), folder) as run:
        collect_run(run)
        calibrate_run(run)
        discover_run(run)
        targets = load_targets(PROFILES / "targets" / "twin.yaml", run.profile)[:FEW_TARGETS]
        push_run(run, targets, verify=True)
    return folder


@pytest.fixture
def finished_copy(finished_run: Path, tmp_path: Path) -> Path:
    """A copy of the finished run that a test may change."""
    return Path(shutil.copytree(finished_run, tmp_path / "run"))
