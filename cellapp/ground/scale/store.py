"""One SQLite file that keeps the result of every task as it comes; a further run computes only what is missing.

The process that asks for the tasks is the only one that writes, with one transaction for each result: whoever is
killed, what was written stays. The file must stand on a local disk: write-ahead logs do not work on network file
systems.
"""

from __future__ import annotations

import contextlib
import hashlib
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from cellapp.ground.errors import InputError
from cellapp.ground.scale.task import Task
from cellapp.ground.scale.worker import Answer

APPLICATION_ID = 0x43655265
"""Marks an SQLite file as a store of results: "CeRe" in ASCII."""
_VERSION = 1
_BUSY_S = 30.0
"""How long a statement waits for another client's transaction, which takes milliseconds."""
_TABLE = """
CREATE TABLE IF NOT EXISTS batch (
    batch TEXT PRIMARY KEY,
    job TEXT NOT NULL,
    kind TEXT NOT NULL,
    program TEXT NOT NULL,
    common TEXT NOT NULL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS result (
    key TEXT PRIMARY KEY,
    kind TEXT NOT NULL,
    batch TEXT NOT NULL,
    parameters TEXT NOT NULL,
    found TEXT,
    failure TEXT NOT NULL,
    exit_code INTEGER NOT NULL,
    cpu_s REAL NOT NULL,
    wall_s REAL NOT NULL,
    peak_mb REAL,
    written TEXT NOT NULL,
    sha256 TEXT NOT NULL
) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS result_batch ON result (batch);
"""


@dataclass(frozen=True)
class Cost:
    """What one task of a ``job`` took: processor and wall time [s], and memory of its process [MB] if known."""

    job: str
    cpu_s: float
    wall_s: float
    peak_mb: float | None


class ResultStore:
    """A store of results, open for writing. Make one with ``open``."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection

    @classmethod
    def open(cls, path: Path, *, new: bool = True) -> ResultStore:
        """Open a store; ``new`` makes one where there is no file.

        Raises
        ------
        InputError
            If the file is missing, no store, damaged, of a newer program, or cannot be made.
        """
        if path.is_dir() or not path.absolute().parent.is_dir():
            raise InputError(f"--store: {path}: expected a file in a folder that exists; nothing was done")
        if not (new or path.is_file()):
            raise InputError(f"{path}: file not found; 'cellapp trials ... --store {path}' makes one")
        with _sentences(path):
            connection = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None)
            try:
                _prepare(path, connection)
            except BaseException:
                connection.close()
                raise
        return cls(path, connection)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.close()

    def answers(self, batch: str) -> dict[str, Answer]:
        """Key -> answer of all tasks of a batch that have a result.

        Raises ``InputError`` if one is not what was written.
        """
        with _sentences(self.path):
            rows = self._connection.execute(
                "SELECT key, found, sha256, cpu_s, wall_s, peak_mb FROM result WHERE batch = ? AND found IS NOT NULL",
                (batch,),
            ).fetchall()
        answers = {}
        for key, found, digest, cpu_s, wall_s, peak_mb in rows:
            if _sha256(key, found) != digest:
                raise InputError(f"{self.path} is damaged: a result is not what was written; move the file away")
            answers[key] = Answer(found=found, cpu_s=cpu_s, wall_s=wall_s, peak_mb=peak_mb)
        return answers

    def others(self, kind: str, batch: str) -> int:
        """Number of results of the same kind, but of another program or from other data."""
        with _sentences(self.path):
            row = self._connection.execute(
                "SELECT COUNT(*) FROM result WHERE kind = ? AND batch <> ?", (kind, batch)
            ).fetchone()
        return int(row[0])

    def begin(self, batch: str, job: str, kind: str, program: str, common: str) -> None:
        """Keep what all tasks of a batch share, beside their results."""
        with _sentences(self.path):
            row = (batch, job, kind, program, common)
            self._connection.execute("INSERT OR IGNORE INTO batch VALUES (?, ?, ?, ?, ?)", row)

    def write(self, batch: str, task: Task, answer: Answer) -> None:
        """Keep an answer; that of a task that failed is replaced when the task is computed again."""
        row = (
            task.key,
            task.kind,
            batch,
            task.parameters,
            answer.found,
            answer.failure,
            answer.exit_code,
            answer.cpu_s,
            answer.wall_s,
            answer.peak_mb,
            datetime.now(UTC).isoformat(timespec="seconds"),
            _sha256(task.key, answer.found or ""),
        )
        with _sentences(self.path):
            self._connection.execute(f"INSERT OR REPLACE INTO result VALUES ({','.join('?' * len(row))})", row)

    def costs(self) -> list[Cost]:
        """What every computed task took."""
        with _sentences(self.path):
            rows = self._connection.execute(
                "SELECT job, cpu_s, wall_s, peak_mb FROM result JOIN batch USING (batch) WHERE found IS NOT NULL"
            ).fetchall()
        return [Cost(*row) for row in rows]


# -- inside -----------------------------------------------------------------------------------------------------------


def _prepare(path: Path, connection: sqlite3.Connection) -> None:
    """Check that the file is a store and whole, or make the table in an empty one."""
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (tables,) = connection.execute("SELECT COUNT(*) FROM sqlite_master").fetchone()
    if application == 0 and tables == 0:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.executescript(
            f"BEGIN IMMEDIATE; PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {_VERSION};"
            f" {_TABLE} COMMIT;"
        )
    elif application != APPLICATION_ID:
        raise InputError(f"{path} is an SQLite file, but no store of results; choose another name")
    elif version > _VERSION:
        raise InputError(f"{path} was written by a newer cellapp (version {version}); install it to use this store")
    else:
        problem = str(connection.execute("PRAGMA quick_check(1)").fetchone()[0])
        if problem != "ok":
            raise InputError(f"{path} is damaged ({problem.splitlines()[-1]}); move the file away and compute again")
    connection.execute("PRAGMA synchronous = NORMAL")  # survives every killed process; see WAL in SQLite's manual


@contextlib.contextmanager
def _sentences(path: Path) -> Iterator[None]:
    """Turn errors of SQLite into an ``InputError`` that names the file and what to do."""
    try:
        yield
    except sqlite3.OperationalError as error:
        raise InputError(
            f"{path}: {error}; check that the disk is neither full nor write-protected and that no other program holds"
            " the file"
        ) from None
    except sqlite3.DatabaseError as error:
        what = "is no store of results" if "not a database" in str(error) else f"is damaged ({error})"
        raise InputError(f"{path} {what}; move the file away or choose another name") from None


def _sha256(key: str, found: str) -> str:
    return hashlib.sha256(f"{key}\n{found}".encode()).hexdigest()
