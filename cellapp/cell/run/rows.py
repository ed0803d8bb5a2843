"""Rows of a run file as objects: lines of the log, stored stages, documents."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass
from datetime import UTC, datetime


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


@dataclass(frozen=True)
class Document:
    """One entry of the table ``result``: when it was written (UTC), and what."""

    written: str
    text: str


def utc_now() -> str:
    """Return the current time in the format of rows (ISO 8601, UTC)."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def select_document(connection: sqlite3.Connection, name: str) -> Document | None:
    """Return a stored document, or None."""
    row = connection.execute("SELECT written, text FROM result WHERE name = ?", (name,)).fetchone()
    return None if row is None else Document(*row)


def insert_document(connection: sqlite3.Connection, name: str, text: str) -> None:
    """Store a document; it replaces an earlier one of that name."""
    connection.execute("INSERT OR REPLACE INTO result VALUES (?, ?, ?)", (name, utc_now(), text))


def insert_event(connection: sqlite3.Connection, level: str, text: str, time_s: float | None) -> None:
    """Add a line to the log."""
    values = (utc_now(), time_s, level, text)
    connection.execute("INSERT INTO event (written, time_s, level, text) VALUES (?, ?, ?, ?)", values)


def select_events(connection: sqlite3.Connection) -> list[Event]:
    """Return the log, oldest line first."""
    rows = connection.execute("SELECT number, written, time_s, level, text FROM event ORDER BY number")
    return [Event(*row) for row in rows]


def insert_stage(
    connection: sqlite3.Connection, name: str, program: str, basis: str | None, text: str, model: str | None
) -> None:
    """Append a stage."""
    values = (name, utc_now(), program, basis, text, model)
    connection.execute(
        "INSERT INTO stage (name, written, program, basis, text, model) VALUES (?, ?, ?, ?, ?, ?)", values
    )


def select_stages(connection: sqlite3.Connection) -> list[StageRow]:
    """Return all stages, oldest first."""
    rows = connection.execute("SELECT number, name, written, program, basis, text, model FROM stage ORDER BY number")
    return [StageRow(*row) for row in rows]
