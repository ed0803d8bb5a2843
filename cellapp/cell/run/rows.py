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
    """The present time as rows have it (ISO 8601, UTC)."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def select_document(connection: sqlite3.Connection, name: str) -> Document | None:
    """A stored document, or None."""
    row = connection.execute("SELECT written, text FROM result WHERE name = ?", (name,)).fetchone()
    return None if row is None else Document(*row)


def insert_document(connection: sqlite3.Connection, name: str, text: str) -> None:
    """Store a document; it replaces an earlier one of that name."""
    connection.execute("INSERT OR REPLACE INTO result VALUES (?, ?, ?)", (name, utc_now(), text))
