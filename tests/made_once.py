"""Folders that cost seconds to make: once for all processes of a session, whichever test asks first."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """The folder ``name``/run of this session, which ``make`` makes if it is not there. No test may write to it.

    A process that asks while another one makes it waits. What could not be made is tried again by the next one.
    """
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ and sys.platform != "win32" else base) / name
    with _locked(folder.with_suffix(".lock")):
        if not folder.exists():
            making = factory.mktemp(name)
            make(making / "run")
            making.rename(folder)
    return folder / "run"


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock of a file among the processes of a session. On Windows every process has a folder of its own."""
    if sys.platform == "win32":
        yield
        return
    import fcntl

    with path.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
