"""Safe opening of run files: checks a file before SQLite may change it, and reports errors in one sentence.

The tables of a run file and the versions of their schema.

Rows of a run file as objects: lines of the log, stored stages, documents.

Rows that collecting adds to a run besides readings: sessions, outcomes of stops, reference measurements.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.profile import profile_from_json, profile_to_json
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.shell import shell_word
from cellapp.robot.effects.registry import program_of


@dataclass(frozen=True)
class Event:
    """One line of the run's log; ``written`` is UTC, ``time_s`` seconds since the run began, if given."""

    number: int
    written: str
    time_s: float | None
    level: str
    text: str


@dataclass(frozen=True)
class StageRow:
    """One row of the table ``stage`` as text; ``cellapp.commands.stages`` gives it its meaning."""

    number: int
    name: str
    written: str
    program: str
    basis: str | None
    text: str
    model: str | None


def utc_now() -> str:
    """Return the current time in the format of rows (ISO 8601, UTC)."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def select_document(connection: sqlite3.Connection, name: str) -> str | None:
    """Return the text of a stored document; None without one."""
    found = connection.execute("SELECT text FROM result WHERE name = ?", (name,)).fetchone()
    return None if found is None else str(found[0])


def insert_document(connection: sqlite3.Connection, name: str, text: str) -> None:
    """Store a document; it replaces an earlier one of that name."""
    connection.execute("INSERT OR REPLACE INTO result VALUES (?, ?, ?)", (name, utc_now(), text))


APPLICATION_ID = 0x43656C6C
SCHEMA_VERSION = 11
"""Version of the schema. New in each version: 2: each joint's last step and the dwell time of a reading. 3: results of
verbs in the table ``stage``. 4: sessions of collecting, outcomes of stops that were not measured, reference
measurements. 5: place of a reading in the order of measurement. 6: recordings of motion. 7: names of points in place of
measured positions. 8: orientation, torques, currents, centre of the payload, nest and station of a reading, and several
readings of an arm at a stop. 9: readings that were replaced when their stop was measured again, and which sessions did
that. 10: covariance of a rotation; torques and currents are no longer read. 11: range of its joints."""
FORMER_COLUMNS = {"tau_nm": "tau", "current_a": "current"}
"""Quantities per joint in files of schemas 8 and 9 -> the stem of their columns in a CSV file. They are kept, and given
as the unknown columns of an imported file are."""

_READING_KEY = "CREATE UNIQUE INDEX reading_key ON reading (arm, configuration, IFNULL(smr, ''), IFNULL(station, ''))"
"""Unique key: an arm has one row per stop, SMR and station. Before schema 8 this was the table's primary key."""
_EXTRAS = "extras TEXT"
"""Unknown columns of an imported file, as one JSON object per reading."""


_STAGE_TABLE = (
    "CREATE TABLE stage (number INTEGER PRIMARY KEY, name TEXT NOT NULL, written TEXT NOT NULL, program TEXT NOT NULL,"
    " basis TEXT, text TEXT NOT NULL, model TEXT)"
)
"""Append-only. Files of schema 1 and 2 lack it; they have results of verbs in the table ``result``."""
_COLLECTION_TABLES = (
    "CREATE TABLE session (number INTEGER PRIMARY KEY, began TEXT NOT NULL, ended TEXT, outcome TEXT, reason TEXT,"
    " again TEXT)",
    "CREATE TABLE request (session INTEGER NOT NULL, written TEXT NOT NULL, kind TEXT NOT NULL, reason TEXT NOT NULL)",
    "CREATE TABLE outcome (stop INTEGER NOT NULL, arm TEXT NOT NULL, kind TEXT NOT NULL, reason TEXT NOT NULL,"
    " PRIMARY KEY (stop, arm))",
    "CREATE TABLE reference (name TEXT NOT NULL, stops_done INTEGER NOT NULL, time_s NOT NULL, p_m TEXT NOT NULL,"
    " session INTEGER NOT NULL)",
)
_RECORDING_TABLES = (
    "CREATE TABLE recording (arm TEXT NOT NULL, name TEXT NOT NULL, about TEXT NOT NULL, sha256 TEXT NOT NULL,"
    " PRIMARY KEY (arm, name))",
    "CREATE TABLE stream (arm TEXT NOT NULL, recording TEXT NOT NULL, kind TEXT NOT NULL, place INTEGER NOT NULL,"
    " name TEXT NOT NULL, words TEXT, data BLOB NOT NULL, PRIMARY KEY (arm, recording, kind, place))",
)
"""A recording of motion, and its columns: ``data`` as in ``recordings``; for texts, indices into ``words``."""

_AGAIN = "ALTER TABLE session ADD COLUMN again TEXT"
"""The stops that a session measured again, as a list; NULL for a session that collects what is left."""


def reading_columns() -> list[str]:
    """Return the names of the columns of a reading, in order."""
    return ["arm", *(column.sql_name for column in COLUMNS), "extras"]


def stored_columns(connection: sqlite3.Connection, table: str) -> list[str]:
    """Return the names of the columns that a table has in this file, in order."""
    return [str(name) for (name,) in connection.execute("SELECT name FROM pragma_table_info(?)", (table,))]


def create_tables(connection: sqlite3.Connection) -> None:
    """Create all tables, inside the caller's transaction."""
    _create_reading_table(connection)
    for statement in (
        _earlier_table(),
        "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL)",
        "CREATE TABLE plan (arm TEXT NOT NULL, stop INTEGER NOT NULL, q TEXT NOT NULL, PRIMARY KEY (arm, stop))",
        "CREATE TABLE event"
        " (number INTEGER PRIMARY KEY, written TEXT NOT NULL, time_s, level TEXT NOT NULL, text TEXT NOT NULL)",
        "CREATE TABLE result (name TEXT PRIMARY KEY, written TEXT NOT NULL, text TEXT NOT NULL)",
        _STAGE_TABLE,
        *_COLLECTION_TABLES,
        *_RECORDING_TABLES,
    ):
        connection.execute(statement)
    connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")


def _reading_columns() -> tuple[str, ...]:
    return ("arm TEXT NOT NULL", *(column.sql_declaration for column in COLUMNS), _EXTRAS)


def _earlier_table() -> str:
    """Return the statement for the table of replaced readings, kept as they were, in the order of replacement."""
    return f"CREATE TABLE earlier_reading ({', '.join((*_reading_columns(), 'replaced TEXT NOT NULL'))})"


def _create_reading_table(connection: sqlite3.Connection) -> None:
    connection.execute(f"CREATE TABLE reading ({', '.join(_reading_columns())})")
    connection.execute(_READING_KEY)


def schema_version(connection: sqlite3.Connection) -> int:
    """Return the schema version with which the file was written."""
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def read_meta(connection: sqlite3.Connection, key: str) -> str | None:
    """Return a value of the table ``meta``, or None."""
    row = connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
    return None if row is None else str(row[0])


def upgrade(connection: sqlite3.Connection) -> None:
    """Add what a file of an older schema lacks, inside the caller's transaction; no stored value is changed."""
    version = schema_version(connection)
    if version == SCHEMA_VERSION:
        return
    for column in COLUMNS:
        if column.since > version:
            for table in ("reading", "earlier_reading") if version >= 9 else ("reading",):
                connection.execute(f"ALTER TABLE {table} ADD COLUMN {column.sql_declaration}")
    if version < 8:
        _rekey_readings(connection)
    earlier = (_earlier_table(), *([_AGAIN] if version >= 4 else []))
    tables = {3: (_STAGE_TABLE,), 4: _COLLECTION_TABLES, 6: _RECORDING_TABLES, 9: earlier}
    for statement in (one for since, its in tables.items() if version < since for one in its):
        connection.execute(statement)
    connection.execute("UPDATE meta SET value = ? WHERE key = 'version'", (str(SCHEMA_VERSION),))
    connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")


def _rekey_readings(connection: sqlite3.Connection) -> None:
    """Move the readings to a table that allows several of an arm at a stop: SQLite cannot drop a primary key."""
    names = ", ".join(reading_columns())
    connection.execute("ALTER TABLE reading RENAME TO reading_before")
    _create_reading_table(connection)
    connection.execute(f"INSERT INTO reading ({names}) SELECT {names} FROM reading_before ORDER BY rowid")
    connection.execute("DROP TABLE reading_before")


def write_new(connection: sqlite3.Connection, profile: Profile) -> None:
    """Create the tables of a new run, and store its profile and versions."""
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("BEGIN")
    create_tables(connection)
    connection.executemany(
        "INSERT INTO meta VALUES (?, ?)",
        {
            "schema": "cellapp-run",
            "version": str(SCHEMA_VERSION),
            "created": utc_now(),
            "program": program_of(profile),
            "profile": profile_to_json(profile),
        }.items(),
    )
    connection.execute(f"PRAGMA application_id={APPLICATION_ID}")
    connection.execute("COMMIT")


def read_profile(path: Path, connection: sqlite3.Connection) -> Profile:
    """Read the profile of a run file. Raise ``InputError`` if it is missing or unreadable."""
    text = read_meta(connection, "profile")
    if text is None:
        raise InputError(f"{path} is damaged (its profile is missing); restore it from a copy")
    try:
        return profile_from_json(text)
    except InputError as error:
        raise InputError(f"{path} holds a profile that this cellapp cannot read: {error}") from None


FILE_NAME = "run.sqlite"
UNFINISHED = FILE_NAME + ".new"
"""Name of a run file while it is created; it gets its final name when it is complete."""
REPORT_FILE = "report.html"
"""Name of the report's page in a run's folder."""
"""Marks an SQLite file as a run: "Cell" in ASCII."""

_MAGIC = b"SQLite format 3\x00"
_HEADER_BYTES = 100
_BUSY_S = 10.0
"""Time that a statement waits for another program's transaction, which takes milliseconds."""


def connect(path: Path, mode: str, wait_s: float = _BUSY_S) -> sqlite3.Connection:
    """Connect with ``mode`` ``ro`` or ``rw``, without implicit transactions, for use in any thread.

    ``wait_s`` is how long a statement waits for another program's lock.
    """
    return sqlite3.connect(
        f"{path.absolute().as_uri()}?mode={mode}",
        uri=True,
        timeout=wait_s,
        isolation_level=None,
        check_same_thread=False,
    )


def make_empty_folder(folder: Path) -> list[Path]:
    """Make the folder if it is missing; return the folders that were made, innermost first.

    Raises
    ------
    InputError
        If it holds anything, cannot be made, or is a file.
    """
    if folder.is_dir():
        with sentences(folder):
            names = sorted(one.name for one in folder.iterdir() if one.is_dir() or not one.name.startswith(UNFINISHED))
        if FILE_NAME in names:
            raise InputError(
                f"{folder} already holds a run ({FILE_NAME}): 'cellapp show {shell_word(folder)}' says what"
                " comes next in it;"
                " for another run choose a new folder"
            )
        if names:
            shown = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
            raise InputError(f"{folder} is not empty ({shown}); a run needs an empty or new folder, choose another one")
        return []
    if folder.exists():
        raise InputError(f"{folder} is a file; a run needs a folder of its own, choose another name")
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    with sentences(folder):
        folder.mkdir(parents=True)
    return missing


def check_header(folder: Path, path: Path) -> None:
    """Check the first bytes, whose layout is part of SQLite's file format, before SQLite opens the file.

    Raises
    ------
    InputError
        If it is missing, no run file, cut off, or of a newer schema.
    """
    if not folder.exists():
        raise InputError(f"{folder}: run folder not found; plan, import or run makes one")
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give the folder that holds {FILE_NAME}")
    if not path.exists():
        raise InputError(f"{folder} holds no run ({FILE_NAME} is missing); give the folder of a run")
    with path.open("rb") as file:
        header = file.read(_HEADER_BYTES)
        size = file.seek(0, os.SEEK_END)
    if not _MAGIC.startswith(header[: len(_MAGIC)]):
        raise InputError(f"{path} is not a run file (not SQLite); check the folder's name")
    if len(header) < _HEADER_BYTES:
        raise InputError(f"{path} is cut off ({size} bytes); restore it from a copy")
    version, application = int.from_bytes(header[60:64], "big"), int.from_bytes(header[68:72], "big")
    if application != APPLICATION_ID:
        raise InputError(f"{path} is an SQLite file, but not a run of cellapp; check the folder's name")
    if version > SCHEMA_VERSION:
        raise InputError(
            f"{path} was written by a newer cellapp (schema {version}, this one reads up to {SCHEMA_VERSION});"
            " install the newer cellapp to open it"
        )
    log = Path(f"{path}-wal")  # may hold pages that the file lacks; SQLite's own check follows
    stated = int.from_bytes(header[28:32], "big") * int.from_bytes(header[16:18], "big")
    # SQLite trusts the stated size only if both counters of changes agree; its check misses part of the last page.
    if size < stated and header[24:28] == header[92:96] and not (log.exists() and log.stat().st_size):
        raise InputError(f"{path} is cut off: {size} bytes of {stated} are there; restore it from a copy")


def check_integrity(path: Path, connection: sqlite3.Connection) -> None:
    """Let SQLite check its pages. Raise ``InputError`` for a damaged file."""
    problems = [str(row[0]) for row in connection.execute("PRAGMA quick_check(3)")]
    if problems != ["ok"]:
        raise InputError(f"{path} is damaged ({problems[0].splitlines()[-1]}); restore it from a copy")


@contextlib.contextmanager
def sentences(folder: Path) -> Iterator[None]:
    """Convert errors of SQLite and of the file system to an ``InputError`` that names the file and what to do."""
    path = folder / FILE_NAME
    try:
        yield
    except sqlite3.OperationalError as error:
        if "no such table" in str(error):
            raise InputError(f"{path} is damaged ({error}); restore it from a copy") from None
        raise InputError(
            f"{path}: {error}; check that the disk is neither full nor write-protected"
            " and that no other program holds the file"
        ) from error
    except sqlite3.ProgrammingError as error:
        raise InputError(f"{path}: {error}") from error
    except sqlite3.DatabaseError as error:
        raise InputError(f"{path} is damaged ({error}); restore it from a copy") from error
    except OSError as error:
        where = error.filename or folder
        raise InputError(f"{where}: {error.strerror or error}; check the path and its permissions") from error


def sync_folder(folder: Path) -> None:
    """Flush the folder's entries to disk, so that a renamed file survives a power failure."""
    if os.name == "posix":  # other systems cannot open a folder and do not need it
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


SessionEnd = Literal["complete", "accurate enough", "stopped", "aborted", "failed"]
"""How a collecting session ended; "accurate enough": the required standard errors were reached early."""
OutcomeKind = Literal["not measured", "left out", "not tried"]


@dataclass(frozen=True)
class SessionRequest:
    """What a person asked in a session, or what suspended or resumed it; ``written`` is UTC."""

    written: str
    kind: str
    reason: str


@dataclass(frozen=True)
class Session:
    """One session of collecting; ``ended``, ``outcome`` and ``reason`` are None if the program died in it.

    ``requests`` lists requests of persons and interruptions, oldest first: (UTC, "pause" | "resume" | ..., reason).
    ``again`` lists the stops that were measured again, counted from 1; empty in a session that collects what is left.
    """

    number: int
    began: str
    ended: str | None
    outcome: SessionEnd | None
    reason: str | None
    requests: tuple[SessionRequest, ...]
    again: str = ""


def last_session(sessions: Sequence[Session]) -> Session | None:
    """Return the last session that collected remaining stops (none measured again); None if there is none."""
    return next((one for one in reversed(sessions) if not one.again), None)


@dataclass(frozen=True)
class Outcome:
    """Why an arm has no reading at a stop. The newest row of a stop and arm counts, and only without a reading.

    A stop that was not tried has no row.
    """

    stop: int
    arm: str
    kind: OutcomeKind
    reason: str


@dataclass(frozen=True, eq=False)
class ReferenceRow:
    """One reference measurement: "arm NAME" at home or "nest NAME", after a number of stops, ``p_M`` (3,) [m]."""

    name: str
    stops_done: int
    time_s: float
    p_M: NDArray[np.float64]
    session: int


def insert_outcome(connection: sqlite3.Connection, outcome: Outcome) -> None:
    """Add an outcome; it replaces an earlier one of the same stop and arm."""
    connection.execute(
        "INSERT OR REPLACE INTO outcome VALUES (?, ?, ?, ?)", (outcome.stop, outcome.arm, outcome.kind, outcome.reason)
    )
