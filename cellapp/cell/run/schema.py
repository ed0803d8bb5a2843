"""The tables of a run file and the versions of their schema."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from cellapp.cell.profile import profile_from_json, profile_to_json
from cellapp.cell.run.rows import utc_now
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.plugins import program_of

APPLICATION_ID = 0x43656C6C
SCHEMA_VERSION = 10
"""Version of the schema. New in each version: 2: each joint's last step and the dwell time of a reading. 3: results of
verbs in the table ``stage``. 4: sessions of collecting, outcomes of stops that were not measured, reference
measurements. 5: place of a reading in the order of measurement. 6: recordings of motion. 7: names of points in place of
measured positions. 8: orientation, torques, currents, centre of the payload, nest and station of a reading, and several
readings of an arm at a stop. 9: readings that were replaced when their stop was measured again, and which sessions did
that. 10: covariance of a rotation."""

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
"""A recording of motion, and its columns: ``data`` as in ``stream_codes``; for texts, indices into ``words``."""

_AGAIN = "ALTER TABLE session ADD COLUMN again TEXT"
"""The stops that a session measured again, as a list; NULL for a session that collects what is left."""


def reading_columns() -> list[str]:
    """Return the names of the columns of a reading, in order."""
    return ["arm", *(column.sql_name for column in COLUMNS), "extras"]


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
