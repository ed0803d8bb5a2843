"""Distributions with plug-ins, installed for a test: in this process or for commands in another one."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellapp.cell.exports.formats import all_formats
from cellapp.ground.profile.device_plugins import ARM_TYPES
from cellapp.ground.profile.schema import Arm, Profile, Sensors, Tracker
from cellapp.robot.effects import EFFECTS
from drivers.arms.registry import ARMS
from drivers.plugins import Registry
from drivers.sensors.registry import AIR_SENSORS
from drivers.trackers.registry import TRACKERS

REPOSITORY = Path(__file__).parents[3]
EXAMPLE = Path(__file__).parent / "example_plugin"
"""The distribution of the handbook's chapter on plug-ins."""
REGISTRIES: tuple[Registry[Any], ...] = (ARMS, TRACKERS, AIR_SENSORS, ARM_TYPES, EFFECTS, all_formats())
Groups = Mapping[str, Mapping[str, str]]
"""Group -> name -> target of entry points."""


def add_distribution(
    folder: Path, name: str, groups: Groups, modules: Mapping[str, str] | None = None, version: str = "1.0"
) -> Path:
    """Write modules (file -> text) and the metadata of a distribution into a folder of ``sys.path``; return it."""
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n", "utf-8")
    sections = ([f"[{group}]", *(f"{key} = {target}" for key, target in of.items())] for group, of in groups.items())
    (info / "entry_points.txt").write_text("\n".join(line for lines in sections for line in lines) + "\n", "utf-8")
    for file, text in (modules or {}).items():
        (folder / file).write_text(text, "utf-8")
    return folder


def add_example(folder: Path) -> Path:
    """The example as its ``pyproject.toml`` declares it, without building it; return the folder."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text("utf-8"))["project"]
    add_distribution(folder, project["name"], project["entry-points"], version=project["version"])
    shutil.copytree(EXAMPLE / "cellapp_example", folder / "cellapp_example")
    return folder


def add_toys(folder: Path) -> Path:
    """The tracker and the weather station that only tests know; return the folder."""
    groups = {
        "cellapp.drivers.trackers": {"toy": "tests.cell.driving.toys.tracker:ToyTrackerSettings"},
        "cellapp.drivers.sensors": {"toy": "tests.cell.driving.toys.station:ToyStationSettings"},
    }
    return add_distribution(folder, "cellapp-toys", groups)


@contextmanager
def installed(*folders: Path) -> Iterator[None]:
    """The distributions of some folders, in this process; the registries are read again, then and afterwards."""
    earlier_path, earlier_modules = list(sys.path), set(sys.modules)
    earlier = [vars(registry).pop("_found", None) for registry in REGISTRIES]
    sys.path[:0] = map(str, folders)
    importlib.invalidate_caches()
    _renew_profile()
    try:
        yield
    finally:
        sys.path[:] = earlier_path
        for name in set(sys.modules) - earlier_modules:
            file = getattr(sys.modules[name], "__file__", None) or ""
            if any(Path(file).is_relative_to(folder) for folder in folders):
                del sys.modules[name]
        for registry, found in zip(REGISTRIES, earlier, strict=True):
            vars(registry).pop("_found", None)
            vars(registry).update({} if found is None else {"_found": found})
        _renew_profile()


def _renew_profile() -> None:
    """Make the profile's schema again, from the kinds that there are now."""
    for section in (Arm, Tracker, Sensors, Profile):
        section.model_rebuild(force=True)


@dataclass(frozen=True)
class Ended:
    """Exit codes of commands, and what they wrote on standard output and standard error."""

    codes: list[int]
    out: str
    err: str


def run_commands(folders: Sequence[Path], *commands: str) -> Ended:
    """Run commands of ``cellapp`` in one new process in which the distributions of some folders are installed."""
    path = os.pathsep.join(map(str, (*folders, REPOSITORY)))
    done = subprocess.run(
        [sys.executable, "-m", "tests.interfaces.plugins.commands", json.dumps([line.split() for line in commands])],
        cwd=REPOSITORY, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    codes: Any = json.loads(done.stdout.splitlines()[-1])
    return Ended(codes, done.stdout, done.stderr)
