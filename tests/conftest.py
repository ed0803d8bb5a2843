"""A small run of the simulated cell, made once a session by the verbs themselves."""

from __future__ import annotations

import os

# One thread of linear algebra: most matrices here are small, and a second thread makes them slower on two cores.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import contextlib
import gc
import importlib
import shutil
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
import typer.testing
from hypothesis import HealthCheck, settings
from xdist.remote import Producer

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.targets.targets import load_targets
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.commands.plan.run import new_planned_run
from tests.made_once import made_once
from tests.scheduling import PROCESSES, FromBothEnds, in_order, leave_the_processor
from tests.twin import PROFILES, finished_twin
from tests.verbs import push_run

ROOT = Path(__file__).parent
FEW_TARGETS = 2
_COUNTED = "documented "
"""What properties of tests begin with whose numbers are added up for the end of the session."""
_IN_MEMORY, _ROOM = Path("/dev/shm"), 4 << 30
"""Where tests write if it is there and has this room [bytes]: a run waits until the disk has each of its stops, which
is half of the time of tests of runs. They leave nothing there unless one fails."""
_COLLECTED_AFTER = (20_000, 10, 10)
"""Thresholds of Python's collector: by its own (700, 10, 10) it takes a fifth of the time of tests of screens."""


def pytest_addoption(parser: pytest.Parser) -> None:
    said = "run tests marked 'slow', too; always so where files or folders are named"
    parser.addoption("--all", action="store_true", help=said)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many commands and examples of the handbook were run, and how many were only read."""
    counts = Counter[str]()
    for reports in terminalreporter.stats.values():
        for report in reports:
            counts.update({key: n for key, n in getattr(report, "user_properties", ()) if key.startswith(_COUNTED)})
    for key, number in sorted(counts.items()):
        terminalreporter.write_line(f"{key}: {number}")


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Of several processes each loads the files from another one on: what one has compiled, the others only read."""
    given = getattr(session.config, "workerinput", None)
    if given is None:
        return
    files = sorted(ROOT.rglob("test_*.py"))
    first = len(files) * int(given["workerid"].removeprefix("gw")) // given["workercount"]
    for path in files[first:] + files[:first]:
        with contextlib.suppress(Exception, pytest.skip.Exception):  # collecting meets it again, and reports it
            importlib.import_module(".".join(path.relative_to(ROOT.parent).with_suffix("").parts))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put the tests in their order, and leave out what only repeats."""
    in_order(items)
    if config.getoption("--all"):
        return
    config.hook.pytest_deselected(items=[item for item in items if item.get_closest_marker("slow")])
    items[:] = [item for item in items if not item.get_closest_marker("slow")]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Processes for ``pytest -n auto``: more than two cores have, as some wait; none for a part of the tests.

    A file's tests share a process, which has loopback addresses of its own (``loopback.own_address``).
    """
    return PROCESSES if config.args_source == pytest.Config.ArgsSource.TESTPATHS else 0


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> FromBothEnds | None:
    return FromBothEnds(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_configure(config: pytest.Config) -> None:
    """Prepare a process; whoever names files or folders wants all of their tests."""
    leave_the_processor(config)
    gc.set_threshold(*_COLLECTED_AFTER)
    if _IN_MEMORY.is_dir() and _has_room(_IN_MEMORY):
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(_IN_MEMORY))
    build = "_get_command"  # all commands, before each that a runner invokes
    setattr(typer.testing, build, cache(getattr(typer.testing, build)))
    if not hasattr(config, "workerinput") and config.args_source != pytest.Config.ArgsSource.TESTPATHS:
        config.option.all = True


def _has_room(folder: Path) -> bool:
    """Whether all tests may write to a folder, and run what they write."""
    found = os.statvfs(folder)
    return os.access(folder, os.W_OK) and not found.f_flag & os.ST_NOEXEC and found.f_bavail * found.f_frsize > _ROOM


def pytest_collection_finish() -> None:
    """Pass over modules and collected tests no more: they are 600 000 objects, and a test of a screen makes garbage for
    several full passes of Python's collector."""
    gc.freeze()


# an example that takes long, on a busy computer, is no fault
settings.register_profile("cellapp", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("cellapp")


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run that was collected, calibrated, searched and verified at two targets. No test may write to it."""

    def make(folder: Path) -> None:
        with new_planned_run(finished_twin(), folder) as run:
            collect_run(run)
            calibrate_run(run)
            discover_run(run)
            targets = load_targets(PROFILES / "targets" / "twin.yaml", run.profile)[:FEW_TARGETS]
            push_run(run, targets, verify=True)

    return made_once(tmp_path_factory, "finished-run", make)


@pytest.fixture
def finished_copy(finished_run: Path, tmp_path: Path) -> Path:
    """A copy of the finished run that a test may change."""
    return Path(shutil.copytree(finished_run, tmp_path / "run"))
