"""Index of the records of all runs below a folder, so that only changed runs are read again.

The run files are the source. The index is an SQLite file beside them that may be deleted at any time: a row counts only
if path, size, time and newest stage match the run file, and its text matches the stored hash. A damaged index is
rebuilt; if it cannot be written or is in use, the runs are read without it.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from cellapp.cell.run.sqlite_file import FILE_NAME, connect
from cellapp.commands.basis import sha256_of
from cellapp.commands.fleet.reading import read_record
from cellapp.commands.runs.history import run_folders
from cellapp.estimation.monitoring.fleet.record import RunRecord
from cellapp.ground.version import __version__

INDEX_FILE = ".cellapp-index.sqlite"
_VERSION = f"1, cellapp {__version__}"
"""Version of the records; rows of another version are read again from their runs."""
_BUSY_S = 0.5
"""How long to wait for another process: reading the runs takes about as long."""


@dataclass(frozen=True)
class Stamp:
    """What changes whenever a run does: size [bytes] and time [ns] of its file and log, and the newest stage."""

    size: int
    mtime_ns: int
    log_size: int
    log_mtime_ns: int
    stage: int


@dataclass(frozen=True)
class IndexedRecords:
    """Records of the runs below a folder, and how many were read from the run files."""

    records: tuple[RunRecord, ...]
    read: int


def indexed_records(folder: Path) -> IndexedRecords:
    """Return the record of every run in ``folder`` and below. A single run has no index: it is read."""
    runs = list(run_folders(folder))
    if runs == [folder]:
        return IndexedRecords((read_record(folder),), 1)
    stored = _load(folder)
    stamps = {run: stamp_of(run) for run in runs}
    records: dict[Path, RunRecord] = {}
    fresh: dict[Path, RunRecord] = {}
    for run, stamp in stamps.items():
        found = stored.get(_key(folder, run))
        if found is not None and stamp is not None and found[0] == stamp:
            records[run] = found[1].model_copy(update={"run": str(run)})
        else:
            records[run] = fresh[run] = read_record(run)
    keys = {_key(folder, run) for run in runs}
    if fresh or stored.keys() - keys:
        # only records that hold as long as the run does not change: a problem may pass, a prior may change
        lasting = {run: record for run, record in fresh.items() if record.alone and not record.problem}
        rows = [(run, stamp, record) for run, record in lasting.items() if (stamp := stamps[run])]
        _store(folder, rows, keys)
    return IndexedRecords(tuple(records.values()), len(fresh))


def stamp_of(run: Path) -> Stamp | None:
    """Return the stamp of a run; None if its file cannot be read, or its results are from before stages."""
    path = run / FILE_NAME
    try:
        file = path.stat()
        log = Path(f"{path}-wal")
        log_stat = log.stat() if log.exists() else None
        with contextlib.closing(connect(path, "ro", wait_s=0.0)) as connection:
            (number,) = connection.execute("SELECT MAX(number) FROM stage").fetchone()
    except (OSError, sqlite3.Error):
        return None
    return Stamp(
        file.st_size,
        file.st_mtime_ns,
        0 if log_stat is None else log_stat.st_size,
        0 if log_stat is None else log_stat.st_mtime_ns,
        number or 0,
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _key(folder: Path, run: Path) -> str:
    """Return a run's path relative to the folder, which may be moved with its index."""
    return run.relative_to(folder).as_posix()


def _load(folder: Path) -> dict[str, tuple[Stamp, RunRecord]]:
    """Read the intact rows of this version; none if there is no readable index."""
    path = folder / INDEX_FILE
    if not path.is_file():
        return {}
    try:
        with contextlib.closing(connect(path, "ro", _BUSY_S)) as connection:
            rows = connection.execute(
                "SELECT path, size, mtime_ns, log_size, log_mtime_ns, stage, sha256, text FROM run WHERE version = ?",
                (_VERSION,),
            ).fetchall()
    except sqlite3.Error:
        return {}
    found = {}
    for key, size, mtime_ns, log_size, log_mtime_ns, stage, digest, text in rows:
        with contextlib.suppress(ValidationError, AttributeError, TypeError):
            if sha256_of(text) == digest:
                stamp = Stamp(size, mtime_ns, log_size, log_mtime_ns, stage)
                found[str(key)] = (stamp, RunRecord.model_validate_json(text))
    return found


def _store(folder: Path, rows: Sequence[tuple[Path, Stamp, RunRecord]], keys: set[str]) -> None:
    """Add rows and delete those of runs that are gone; replace a damaged index."""
    path = folder / INDEX_FILE
    if not os.access(folder, os.W_OK):
        return
    for _ in range(2):
        try:
            _write(path, folder, rows, keys)
            return
        except sqlite3.OperationalError:  # in use, or the disk is full: go on without the index
            return
        except sqlite3.DatabaseError:
            for damaged in (path, Path(f"{path}-journal")):
                with contextlib.suppress(OSError):
                    damaged.unlink(missing_ok=True)


def _write(path: Path, folder: Path, rows: Sequence[tuple[Path, Stamp, RunRecord]], keys: set[str]) -> None:
    with contextlib.closing(sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None)) as connection:
        connection.execute("BEGIN IMMEDIATE")
        connection.execute(
            "CREATE TABLE IF NOT EXISTS run (path TEXT PRIMARY KEY, version TEXT NOT NULL, size INTEGER NOT NULL,"
            " mtime_ns INTEGER NOT NULL, log_size INTEGER NOT NULL, log_mtime_ns INTEGER NOT NULL,"
            " stage INTEGER NOT NULL, sha256 TEXT NOT NULL, text TEXT NOT NULL)"
        )
        gone = [(key,) for (key,) in connection.execute("SELECT path FROM run").fetchall() if key not in keys]
        connection.executemany("DELETE FROM run WHERE path = ?", gone)
        connection.executemany(
            "INSERT OR REPLACE INTO run VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                (
                    _key(folder, run),
                    _VERSION,
                    stamp.size,
                    stamp.mtime_ns,
                    stamp.log_size,
                    stamp.log_mtime_ns,
                    stamp.stage,
                    sha256_of(text := record.model_dump_json()),
                    text,
                )
                for run, stamp, record in rows
            ),
        )
        connection.execute("COMMIT")
