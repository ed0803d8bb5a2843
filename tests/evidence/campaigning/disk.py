"""A run file on a disk that may be full, write-protected or slow, and a program that may die in a transaction."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cellapp.cell.run import Outcome, RunFile
from cellapp.cell.run.sqlite_file import FILE_NAME
from cellapp.estimation.readings import Readings
from drivers.plant import Plant
from tests.evidence.campaigning.doubles import Process
from tests.evidence.campaigning.monitor import Monitor

DiskState = Literal["healthy", "full", "read-only", "slow"]
DeathPoint = Literal["before the transaction", "before its commit", "after its commit"]

_UNLIMITED_PAGES = 2**30


@dataclass
class Disk:
    """The disk of a campaign. ``dies`` kills the program at a point of the next transaction."""

    plant: Plant
    process: Process
    monitor: Monitor
    kill: Callable[[], None]
    state: DiskState = "healthy"
    slow_s: float = 0.0
    dies: DeathPoint | None = None
    _applied: DiskState = "healthy"

    def begin(self, connection: sqlite3.Connection) -> None:
        """A transaction begins."""
        self.process.check()
        if self.state == "slow":
            self.plant.advance(self.slow_s)
        if self.state != self._applied:
            pages = 1 if self.state == "full" else _UNLIMITED_PAGES  # never below what the file has
            connection.execute(f"PRAGMA max_page_count={pages}").fetchall()
            connection.execute(f"PRAGMA query_only={int(self.state == 'read-only')}")
            self._applied = self.state
        self.reach("before the transaction")

    def reach(self, point: DeathPoint) -> None:
        """Kill the program if it is to die here."""
        if self.dies == point:
            self.dies = None
            self.kill()

    def attached(self) -> None:
        """A new process opened the file."""
        self._applied = "healthy"


class CampaignRun(RunFile):
    """A run file on a ``Disk``. What it reports as stored is recorded by the monitor."""

    disk: Disk | None = None

    def attach(self, disk: Disk) -> None:
        """Use ``disk`` from now on."""
        self.disk = disk
        disk.attached()

    @contextmanager
    def change(self) -> Iterator[sqlite3.Connection]:
        if self.disk is None:
            with super().change() as connection:
                yield connection
            return
        with self.look() as connection:
            self.disk.begin(connection)
        with super().change() as connection:
            yield connection
            self.disk.reach("before its commit")
        self.disk.reach("after its commit")

    def add_stop(self, configuration: int, rows: Mapping[str, Readings], outcomes: Sequence[Outcome] = ()) -> None:
        """Store a stop, and record that it was reported as stored."""
        super().add_stop(configuration, rows, outcomes)
        if self.disk is not None:
            self.disk.monitor.reported(configuration, {name: reading.p_M[0] for name, reading in rows.items()})


def copy_run(folder: Path, to: Path) -> None:
    """Copy a run as it is on the disk at this moment: what a new process finds after the death of another one."""
    to.mkdir()
    for name in (FILE_NAME, f"{FILE_NAME}-wal"):
        if (folder / name).exists():
            shutil.copyfile(folder / name, to / name)
