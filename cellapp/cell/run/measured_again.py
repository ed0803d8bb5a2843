"""Stops that were measured again: the newest reading counts; replaced readings are kept unchanged.

What the readings of a run lack, and how its reference measurements drifted; nothing is written.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.file import RunFile, check_readings, insert_readings, select_readings
from cellapp.cell.run.records import ReferenceDrift
from cellapp.cell.run.sqlite_file import Outcome, insert_outcome, schema_version, stored_columns, utc_now
from cellapp.estimation.readings.readings import Readings

_SINCE = 9
"""Schema version from which on a stop may be measured again."""


def replace_stop(run: RunFile, stop: int, rows: Mapping[str, Readings], outcomes: Sequence[Outcome] = ()) -> None:
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
    batches = {arm: reading.at_stop(stop) for arm, reading in rows.items()}
    for arm, readings in batches.items():
        check_readings(arm, len(run.profile.arms[arm].type.joints), readings)
    with run.change() as connection:
        for arm, readings in batches.items():
            split = _set_aside(connection, arm, stop)
            insert_readings(connection, arm, readings if split is None else replace(readings, split=split))
        for outcome in outcomes:
            if not _has_reading(connection, outcome.arm, stop):
                insert_outcome(connection, outcome)


def earlier_readings(run: RunFile, arm: str) -> tuple[Readings, tuple[str, ...]]:
    """Return the replaced readings of an arm, by stop, the oldest first, and when each was replaced (ISO 8601, UTC).

    None in a file of an older schema.
    """
    with run.look() as connection:
        if schema_version(connection) < _SINCE:
            return run.rows(arm).take([]), ()
        times = connection.execute(
            "SELECT replaced FROM earlier_reading WHERE arm = ? ORDER BY configuration, rowid", (arm,)
        )
        joints = len(run.profile.arms[arm].type.joints)
        return select_readings(connection, arm, joints, "earlier_reading"), tuple(replaced for (replaced,) in times)


def replaced_counts(run: RunFile) -> dict[str, int]:
    """Count the replaced readings of each arm; arms without one are left out."""
    return dict(run.select("SELECT arm, COUNT(*) FROM earlier_reading GROUP BY arm", _SINCE))


def _has_reading(connection: sqlite3.Connection, arm: str, stop: int) -> bool:
    found = connection.execute("SELECT 1 FROM reading WHERE arm = ? AND configuration = ?", (arm, stop))
    return found.fetchone() is not None


def _set_aside(connection: sqlite3.Connection, arm: str, stop: int) -> tuple[str | None, ...] | None:
    """Move a reading to the replaced ones; return its split as a tuple, None if there was no reading."""
    where, key = "WHERE arm = ? AND configuration = ?", (arm, stop)
    row = connection.execute(f"SELECT split FROM reading {where}", key).fetchone()
    if row is None:
        return None
    there = stored_columns(connection, "earlier_reading")
    names = ", ".join(name for name in stored_columns(connection, "reading") if name in there)
    connection.execute(
        f"INSERT INTO earlier_reading ({names}, replaced) SELECT {names}, ? FROM reading {where}", (utc_now(), *key)
    )
    connection.execute(f"DELETE FROM reading {where}", key)
    return (row[0],)


def missing_readings(run: RunFile) -> tuple[Outcome, ...]:
    """List the planned readings that a run lacks, with reasons; reserve stops that were not needed are not missing."""
    plan = run.read_plan()
    total = len(next(iter(plan.values()))) if plan else 0
    outcomes = {(one.stop, one.arm): one for one in run.outcomes()}
    stored = {name: set(run.rows(name).configuration.tolist()) for name in plan}
    reserves = run.profile.plan.reserves(total)
    missing = []
    for stop in range(total):
        for name in plan:
            outcome = outcomes.get((stop, name))
            if stop in stored[name] or (outcome is None and stop in reserves):
                continue
            missing.append(outcome or Outcome(stop, name, "not tried", "the session ended before"))
    return tuple(missing)


def missing_share(run: RunFile, missing: Sequence[Outcome]) -> float:
    """Return the share of the required readings that is missing; a measured reserve stop replaces a missing one."""
    asked = sum(len(q) - len(run.profile.plan.reserves(len(q))) for q in run.read_plan().values())
    counts = run.split_counts()
    measured = sum(sum(counts.get(name, {}).values()) for name in run.read_plan())
    return max(asked - measured, 0) / asked if asked and missing else 0.0


def reference_drifts(run: RunFile) -> tuple[ReferenceDrift, ...]:
    """Compute the distance of every reference measurement from the first one of its name in the run."""
    first: dict[str, NDArray[np.float64]] = {}
    return tuple(
        ReferenceDrift(
            name=row.name,
            stops_done=row.stops_done,
            drift_mm=float(np.linalg.norm(row.p_M - first.setdefault(row.name, row.p_M))) * 1e3,
        )
        for row in run.references()
    )
