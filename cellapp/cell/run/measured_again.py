"""Stops that were measured again: the newest reading counts; replaced readings are kept unchanged."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from cellapp.cell.run.collection_rows import Outcome, insert_outcome
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.readings_table import check_readings, insert_readings, select_readings
from cellapp.cell.run.rows import utc_now
from cellapp.cell.run.schema import reading_columns, schema_version
from cellapp.estimation.readings.readings import Reading, Readings

_SINCE = 9
"""Schema version from which on a stop may be measured again."""


@dataclass(frozen=True)
class Earlier:
    """The replaced readings of one arm, by stop, the oldest first.

    Attributes
    ----------
    readings : Readings
    replaced : tuple of str
        When each was replaced (ISO 8601, UTC).
    """

    readings: Readings
    replaced: tuple[str, ...]


def replace_stop(
    run: RunFile,
    stop: int,
    rows: Mapping[str, Reading],
    outcomes: Sequence[Outcome] = (),
) -> None:
    """Store one stop that was measured again, in one transaction; on return it is on disk.

    The previous reading is kept, and the new one takes its split: measuring again moves no stop between identification
    and validation. An arm without a new reading keeps its previous one; ``outcomes`` are stored for arms that have
    neither.

    Raises
    ------
    InputError
        If the run file cannot be written.
    ValueError
        If an array has the wrong shape or a required value is not finite.
    """
    batches = {arm: reading.as_readings(stop) for arm, reading in rows.items()}
    for arm, readings in batches.items():
        check_readings(arm, len(run.profile.arms[arm].type.joints), readings)
    with run.change() as connection:
        for arm, readings in batches.items():
            split = _set_aside(connection, arm, stop)
            insert_readings(connection, arm, readings if split is None else replace(readings, split=split))
        for outcome in outcomes:
            if not _has_reading(connection, outcome.arm, stop):
                insert_outcome(connection, outcome)


def earlier_readings(run: RunFile, arm: str) -> Earlier:
    """Return the replaced readings of an arm; none in a file of an older schema."""
    with run.look() as connection:
        if schema_version(connection) < _SINCE:
            return Earlier(run.rows(arm).take([]), ())
        times = connection.execute(
            "SELECT replaced FROM earlier_reading WHERE arm = ? ORDER BY configuration, rowid", (arm,)
        )
        joints = len(run.profile.arms[arm].type.joints)
        return Earlier(
            select_readings(connection, arm, joints, "earlier_reading"), tuple(replaced for (replaced,) in times)
        )


def replaced_counts(run: RunFile) -> dict[str, int]:
    """Count the replaced readings of each arm; arms without one are left out."""
    with run.look() as connection:
        if schema_version(connection) < _SINCE:
            return {}
        return dict(connection.execute("SELECT arm, COUNT(*) FROM earlier_reading GROUP BY arm").fetchall())


def _has_reading(connection: sqlite3.Connection, arm: str, stop: int) -> bool:
    found = connection.execute("SELECT 1 FROM reading WHERE arm = ? AND configuration = ?", (arm, stop))
    return found.fetchone() is not None


def _set_aside(connection: sqlite3.Connection, arm: str, stop: int) -> tuple[str | None, ...] | None:
    """Move a reading to the replaced ones; return its split as a tuple, None if there was no reading."""
    where, key = "WHERE arm = ? AND configuration = ?", (arm, stop)
    row = connection.execute(f"SELECT split FROM reading {where}", key).fetchone()
    if row is None:
        return None
    names = ", ".join(reading_columns())
    connection.execute(
        f"INSERT INTO earlier_reading ({names}, replaced) SELECT {names}, ? FROM reading {where}", (utc_now(), *key)
    )
    connection.execute(f"DELETE FROM reading {where}", key)
    return (row[0],)
