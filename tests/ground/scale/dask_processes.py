"""A Dask scheduler and workers in processes of their own, on free ports of loopback."""

from __future__ import annotations

import os
import queue
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from tests.ground.scale.kinds import LONGEST_S

ROOT = Path(__file__).parents[3]
_SETTINGS = {
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",  # a worker takes a second to start again
    "DASK_DISTRIBUTED__SCHEDULER__IDLE_TIMEOUT": "3 minutes",  # nothing outlives a test that was killed
}


@contextmanager
def scheduler(folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A scheduler and its address."""
    arguments = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0"]
    with _started(arguments, folder, r"Scheduler at: +(\S+)") as (process, (address,)):
        yield process, address


@contextmanager
def workers(address: str, folder: Path, count: int, *, nanny: bool = True) -> Iterator[subprocess.Popen[str]]:
    """Workers of one thread each, and nannies that start killed ones again."""
    arguments = ["worker", address, "--host", "127.0.0.1", "--nthreads", "1", "--nworkers", str(count)]
    with _started(
        [*arguments, "--no-dashboard", "--nanny" if nanny else "--no-nanny"], folder, r"Registered to: +(\S+)", count
    ) as (process, _):
        yield process


@contextmanager
def _started(
    arguments: list[str], folder: Path, pattern: str, count: int = 1
) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """A program of Dask, and what ``pattern`` finds in ``count`` lines of its messages."""
    with subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), **_SETTINGS},
        start_new_session=True,  # nannies and their workers end together
    ) as process:
        assert process.stderr is not None
        found = queue.SimpleQueue[str]()
        reader = threading.Thread(target=_read, args=(process.stderr, pattern, found))
        reader.start()
        try:
            yield process, [found.get(timeout=LONGEST_S) for _ in range(count)]
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            reader.join(LONGEST_S)


def _read(messages: IO[str], pattern: str, found: queue.SimpleQueue[str]) -> None:
    """Read to the end: a program whose messages nobody reads stands still."""
    for line in messages:
        if one := re.search(pattern, line):
            found.put(one.group(1))
