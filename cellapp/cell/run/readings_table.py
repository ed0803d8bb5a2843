"""Readings as rows of the run file, derived from the table of columns."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.schema import reading_columns, schema_version
from cellapp.estimation.readings.columns import COLUMNS, OF_SEVERAL, OF_SOCKETS, SPLITS, Column, Values
from cellapp.estimation.readings.readings import Readings, readings_from_columns
from cellapp.ground.removed import removed_readings


def insert_readings(connection: sqlite3.Connection, arm: str, readings: Readings) -> None:
    """Insert readings, inside the caller's transaction. Raise ``sqlite3.IntegrityError`` for a stop that is stored."""
    names = reading_columns()
    places = ", ".join("?" * len(names))
    connection.executemany(
        f"INSERT INTO reading ({', '.join(names)}) VALUES ({places})",
        ((arm, *row) for row in _rows(readings)),
    )


def count_splits(connection: sqlite3.Connection) -> dict[str, dict[str | None, int]]:
    """Count the readings of each arm, by split; None is no split."""
    counts: dict[str, dict[str | None, int]] = {}
    for arm, split, n in connection.execute(
        "SELECT arm, split, COUNT(DISTINCT configuration) FROM reading GROUP BY arm, split"
    ):
        counts.setdefault(arm, {})[split] = n
    return counts


def mean_temperatures(connection: sqlite3.Connection) -> dict[str, dict[str, float]]:
    """Return mean temperatures [degC] of each arm's readings: of the "air", "joint 1" and so on, where known."""
    air = connection.execute("SELECT arm, 'air', AVG(temperature_c) FROM reading GROUP BY arm")
    joints = connection.execute(
        "SELECT arm, 'joint ' || (joint.key + 1), AVG(joint.value)"
        " FROM reading, json_each(reading.joint_temperature_c) AS joint GROUP BY arm, joint.key"
    )
    means: dict[str, dict[str, float]] = {}
    for arm, where, mean in (*air, *joints):
        if mean is not None:
            means.setdefault(arm, {})[where] = float(mean)
    return means


def select_readings(
    connection: sqlite3.Connection, arm: str, joints: int, table: Literal["reading", "earlier_reading"] = "reading"
) -> Readings:
    """Read all readings of one arm, ordered by configuration; columns that an older schema lacks have no values.

    In the table ``earlier_reading``, those of one configuration are in the order in which they were replaced.
    """
    version = schema_version(connection)
    names = [column.sql_name if column.since <= version else "NULL" for column in COLUMNS]
    rows = connection.execute(
        f"SELECT {', '.join(names)}, extras FROM {table} WHERE arm = ? ORDER BY configuration, rowid", (arm,)
    ).fetchall()
    *columns, extras = zip(*rows, strict=True) if rows else [()] * (len(COLUMNS) + 1)
    values = {
        column.name: _from_cells(column, cells, len(rows), joints)
        for column, cells in zip(COLUMNS, columns, strict=True)
    }
    return readings_from_columns(values, _extras_from_cells(extras))


def select_removed_kinds(connection: sqlite3.Connection) -> dict[str, str]:
    """Return each arm whose readings are of a removed kind, with what to say of them."""
    several = f"SELECT arm FROM reading GROUP BY arm HAVING COUNT(DISTINCT IFNULL({OF_SEVERAL}, '')) > 1"
    in_sockets = f"SELECT DISTINCT arm FROM reading WHERE {OF_SOCKETS} IS NOT NULL"
    found = dict[str, str]()
    for since, column, asked in ((8, OF_SEVERAL, several), (7, OF_SOCKETS, in_sockets)):
        if schema_version(connection) >= since:
            found |= dict.fromkeys((arm for (arm,) in connection.execute(asked)), removed_readings(column))
    return found


def select_stops_done(connection: sqlite3.Connection) -> set[int]:
    """Return the numbers of the stored configurations."""
    return {stop for (stop,) in connection.execute("SELECT DISTINCT configuration FROM reading")}


def check_readings(arm: str, joints: int, readings: Readings) -> None:
    """Check readings of an arm with this number of joints before they are stored.

    Raises
    ------
    ValueError
        If the number of joints differs, a required value is not finite, or a value is not one of those allowed.
    """
    if readings.joints != joints:
        raise ValueError(f"{readings.joints} joint positions for the {joints} joints of arm {arm}")
    for column in COLUMNS:
        values = getattr(readings, column.name)
        if column.required and not np.all(np.isfinite(values)):
            raise ValueError(f"{column.name} of arm {arm} is not finite")
        if column.name == "split":
            check_splits(values or ())
        elif column.allowed and values is not None and not np.all(np.isin(values, column.allowed)):
            raise ValueError(f"{column.name} of arm {arm} is not {column.expected}")


def check_splits(words: Sequence[str | None]) -> None:
    """Check names of splits; None is no split. Raises ``ValueError`` for any other word."""
    for word in words:
        if word is not None and word not in SPLITS:
            raise ValueError(f"'{word}' is not a split; splits are {', '.join(SPLITS)}")


def update_splits(connection: sqlite3.Connection, arm: str, names: Mapping[int, str | None]) -> None:
    """Store the split of all rows of an arm at each stop."""
    connection.executemany(
        "UPDATE reading SET split = ? WHERE arm = ? AND configuration = ?",
        ((name, arm, stop) for stop, name in names.items()),
    )


def vectors_from_json(texts: Sequence[str]) -> NDArray[np.float64]:
    """Build a matrix from the JSON texts of its rows; null is NaN."""
    return np.array(json.loads("[" + ",".join(texts) + "]"), dtype=np.float64)


def _rows(readings: Readings) -> Iterator[tuple[Any, ...]]:
    n = len(readings)
    extras: list[str | None] = [None] * n
    if readings.extras:
        rows = zip(*readings.extras.values(), strict=True)
        extras = [json.dumps(dict(zip(readings.extras, row, strict=True))) for row in rows]
    columns = [_to_cells(column, getattr(readings, column.name), n) for column in COLUMNS]
    return zip(*columns, extras, strict=True)


def _to_cells(column: Column, values: Values | None, n: int) -> Sequence[Any]:
    """Convert to one cell per reading: NULL without a value, null within JSON where one number is missing."""
    if values is None:
        return [None] * n
    if isinstance(values, tuple):
        return values
    matrix = column.matrix(values)
    cells = matrix.astype(object)
    cells[np.isnan(matrix)] = None
    if column.shape == "scalar":
        return [cell for (cell,) in cells.tolist()]
    empty = np.isnan(matrix).all(axis=1) & (not column.required)
    return [None if nothing else json.dumps(row) for nothing, row in zip(empty.tolist(), cells.tolist(), strict=True)]


def _from_cells(column: Column, cells: Sequence[Any], n: int, joints: int) -> Values | None:
    if all(cell is None for cell in cells) and not (n == 0 and column.required):
        return column.missing(n, joints)
    if column.dtype is str:
        return tuple(cells)
    matrix: NDArray[Any]
    if column.shape == "scalar":
        matrix = np.array(cells, dtype=column.dtype)[:, np.newaxis]
    else:
        width = len(column.csv_names(joints))
        nothing = json.dumps([None] * width)
        matrix = vectors_from_json([nothing if cell is None else cell for cell in cells]).reshape(n, width)
    return column.from_matrix(matrix)


def _extras_from_cells(cells: Sequence[str | None]) -> dict[str, tuple[str, ...]]:
    rows = [{} if cell is None else json.loads(cell) for cell in cells]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: tuple(str(row.get(name, "")) for row in rows) for name in names}
