"""Which program computes: results of another one are neither mixed with those of this one nor taken for them."""

from __future__ import annotations

import hashlib
import inspect
import platform
from collections.abc import Callable, Mapping
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path

from cellapp.ground.results import Record
from cellapp.ground.version import __version__

_SHOWN_ONLY = ("interfaces", "docs")
"""Packages that show results and compute none."""
_PACKAGES = ("cellapp", "drivers")
_ARITHMETIC = ("numpy", "scipy")
"""Packages whose version may change the last digits of a result."""


class Program(Record):
    """Versions and sources that a result depends on; ``source`` is the start of the SHA-256 of all modules."""

    version: str
    source: str
    python: str
    packages: dict[str, str]

    @property
    def words(self) -> str:
        """The program in one line."""
        packages = " ".join(f"{name} {number}" for name, number in self.packages.items())
        return f"cellapp {self.version} (source {self.source}), Python {self.python}, {packages}"


@lru_cache(maxsize=1)
def this_program() -> Program:
    """The program of this process."""
    return Program(
        version=__version__,
        source=_digest({package: Path(str(files(package))) for package in _PACKAGES}),
        python=".".join(platform.python_version_tuple()[:2]),
        packages={name: _version(name) for name in _ARITHMETIC},
    )


def program_text() -> str:
    """The program of this process as JSON, to be asked of a worker."""
    return this_program().model_dump_json()


def source_outside(function: Callable[..., object]) -> str:
    """The start of the SHA-256 of the modules beside that of a function which is no part of the program; else empty."""
    package = function.__module__.partition(".")[0]
    return "" if package in _PACKAGES else _digest({package: Path(inspect.getfile(function)).parent})


def _digest(folders: Mapping[str, Path]) -> str:
    found = hashlib.sha256()
    for package, root in folders.items():
        for path in sorted(root.rglob("*.py")):
            place = path.relative_to(root)
            if place.parts[0] not in _SHOWN_ONLY:
                found.update(f"{package}/{place.as_posix()}\n".encode())
                found.update(path.read_bytes())
    return found.hexdigest()[:12]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"
