"""Rows that collecting adds to a run besides readings: sessions, outcomes of stops, reference measurements."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.schema import schema_version
from cellapp.ground.grouping import grouped

SessionEnd = Literal["complete", "accurate enough", "stopped", "aborted", "failed"]
"""How a collecting session ended; "accurate enough": the required standard errors were reached early."""
OutcomeKind = Literal["not measured", "left out"]
_SINCE, _SINCE_AGAIN = 4, 9


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
    requests: tuple[tuple[str, str, str], ...]
    again: str = ""


@dataclass(frozen=True)
class Outcome:
    """Why an arm has no reading at a stop. The newest row of a stop and arm counts, and only without a reading."""

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


def insert_session(connection: sqlite3.Connection, began: str, again: str = "") -> int:
    """Add a session that begins; return its number."""
    row = connection.execute("INSERT INTO session (began, again) VALUES (?, ?)", (began, again or None))
    return int(row.lastrowid or 0)


def insert_request(connection: sqlite3.Connection, session: int, written: str, kind: str, reason: str) -> None:
    """Add a request or an event of a session."""
    connection.execute("INSERT INTO request VALUES (?, ?, ?, ?)", (session, written, kind, reason))


def end_session(connection: sqlite3.Connection, number: int, ended: str, outcome: SessionEnd, reason: str) -> None:
    """Record how a session ended."""
    connection.execute(
        "UPDATE session SET ended = ?, outcome = ?, reason = ? WHERE number = ?", (ended, outcome, reason, number)
    )


def insert_outcome(connection: sqlite3.Connection, outcome: Outcome) -> None:
    """Add an outcome; it replaces an earlier one of the same stop and arm."""
    connection.execute(
        "INSERT OR REPLACE INTO outcome VALUES (?, ?, ?, ?)",
        (outcome.stop, outcome.arm, outcome.kind, outcome.reason),
    )


def delete_outcomes(connection: sqlite3.Connection, stops: Iterable[int]) -> None:
    """Remove the outcomes of stops."""
    connection.executemany("DELETE FROM outcome WHERE stop = ?", ((stop,) for stop in stops))


def insert_reference(connection: sqlite3.Connection, row: ReferenceRow) -> None:
    """Add a reference measurement."""
    connection.execute(
        "INSERT INTO reference VALUES (?, ?, ?, ?, ?)",
        (row.name, row.stops_done, row.time_s, json.dumps(row.p_M.tolist()), row.session),
    )


def select_sessions(connection: sqlite3.Connection) -> list[Session]:
    """Read all sessions, oldest first; none in a file of an older schema."""
    version = schema_version(connection)
    if version < _SINCE:
        return []
    again = "COALESCE(again, '')" if version >= _SINCE_AGAIN else "''"
    requests = grouped(
        (session, (request[0], request[1], request[2]))
        for session, *request in connection.execute("SELECT session, written, kind, reason FROM request ORDER BY rowid")
    )
    rows = connection.execute(f"SELECT number, began, ended, outcome, reason, {again} FROM session ORDER BY number")
    return [
        Session(number, began, ended, outcome, reason, tuple(requests.get(number, ())), stops)
        for number, began, ended, outcome, reason, stops in rows
    ]


def select_outcomes(connection: sqlite3.Connection) -> list[Outcome]:
    """Read the outcomes of stops and arms without a reading, by stop; none in a file of an older schema."""
    if schema_version(connection) < _SINCE:
        return []
    rows = connection.execute(
        "SELECT stop, arm, kind, reason FROM outcome WHERE NOT EXISTS"
        " (SELECT 1 FROM reading WHERE reading.configuration = outcome.stop AND reading.arm = outcome.arm)"
        " ORDER BY stop, arm"
    )
    return [Outcome(*row) for row in rows]


def select_late(connection: sqlite3.Connection) -> set[tuple[int, str]]:
    """Return stops and arms that have a reading now and had none when they were visited before."""
    if schema_version(connection) < _SINCE:
        return set()
    rows = connection.execute(
        "SELECT stop, outcome.arm FROM outcome JOIN reading"
        " ON reading.configuration = outcome.stop AND reading.arm = outcome.arm WHERE kind = 'not measured'"
    )
    return {(stop, arm) for stop, arm in rows}


def select_references(connection: sqlite3.Connection) -> list[ReferenceRow]:
    """Read all reference measurements, oldest first; none in a file of an older schema."""
    if schema_version(connection) < _SINCE:
        return []
    rows = connection.execute("SELECT name, stops_done, time_s, p_m, session FROM reference ORDER BY rowid")
    return [ReferenceRow(row[0], row[1], row[2], np.array(json.loads(row[3])), row[4]) for row in rows]
