"""Small runs, cells and files for tests of run files: of two arms, with recordings, older and spoiled ones."""

from __future__ import annotations

import contextlib
import csv
import os
import random
import sqlite3
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run import RunFile, SessionEnd
from cellapp.cell.run.csv_import import arms_of_table, readings_from_csv
from cellapp.cell.run.csv_text import read_csv_table
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.ground.profile import Profile
from tests.arms import Array

Rows = list[dict[str, str]]


def written(path: Path, rows: Rows) -> Path:
    """The file of these rows."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def older_reading_table(connection: sqlite3.Connection, version: int) -> None:
    """Make the table of readings one of this schema, before 8: without later columns, and with one reading of an arm a
    stop, which no later one replaces."""
    connection.execute("DROP TABLE earlier_reading")
    connection.execute("ALTER TABLE session DROP COLUMN again")
    connection.execute("DROP INDEX reading_key")
    for column in COLUMNS:
        if column.since > version:
            connection.execute(f"ALTER TABLE reading DROP COLUMN {column.sql_name}")
    connection.execute("CREATE UNIQUE INDEX once ON reading (arm, configuration)")


Columns = dict[str, NDArray[np.float64]]


def joint_columns(seconds: float = 10.0, rate_hz: float = 125.0, joints: int = 2, began_s: float = 100.0) -> Columns:
    """Positions and speeds of joints that swing, with the stamps of a controller."""
    time_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    columns = {"time_s": began_s + time_s}
    columns |= {f"q{j}": 0.5 * np.sin(0.7 * j * time_s + j) for j in range(1, joints + 1)}
    return columns | {f"qd{j}": 0.35 * j * np.cos(0.7 * j * time_s + j) for j in range(1, joints + 1)}


def point_columns(seconds: float = 10.0, rate_hz: float = 250.0, began_s: float = 3.0) -> Columns:
    """Points on a curve, with the stamps of a tracker."""
    time_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    noise = np.random.default_rng(1).normal(0.0, 1e-5, (3, len(time_s)))
    curve = np.stack([2.0 + 0.3 * np.sin(time_s), 0.4 * np.cos(0.7 * time_s), 0.1 * time_s / seconds])
    return {"time_s": began_s + time_s, **dict(zip(("x_m", "y_m", "z_m"), curve + noise, strict=True))}


def write_columns(path: Path, columns: Mapping[str, Sequence[float | str] | NDArray[np.float64]]) -> Path:
    """Write a file whose numbers read back bit for bit; NaN is an empty cell."""
    cells = [[_cell(value) for value in list(its)] for its in columns.values()]
    rows = [",".join(row) for row in zip(*cells, strict=True)]
    path.write_text("\n".join([",".join(columns), *rows]) + "\n", "utf-8")
    return path


def _cell(value: float | str) -> str:
    return value if isinstance(value, str) else "" if np.isnan(value) else repr(float(value))


def planned_run(folder: Path, stops: int = 4, profile: Profile | None = None) -> RunFile:
    """A run with a plan for both arms; it is open for writing."""
    run = RunFile.create(folder, profile or two_arms())
    run.write_plan({"left": np.arange(2.0 * stops).reshape(stops, 2), "right": np.zeros((stops, 3))})
    return run


def add_stop(run: RunFile, stop: int) -> None:
    """A stop of both arms."""
    run.add_stop(
        stop,
        {
            name: Readings.one(q=np.full(len(arm.type.joints), float(stop)), p_M=np.ones(3), time_s=float(stop))
            for name, arm in run.profile.arms.items()
        },
    )


def collected_run(folder: Path, outcome: SessionEnd | None, measured: int = 2, stops: int = 4) -> Path:
    """A run with one session that measured some of the stops; None: the program died in it."""
    with planned_run(folder, stops) as run:
        session = run.begin_session()
        for stop in range(measured):
            add_stop(run, stop)
        if outcome is not None:
            run.end_session(session, outcome, "")
    return folder


def alter_file(folder: Path, statement: str, *values: str) -> None:
    """Change the file of a run as no part of cellapp does."""
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as connection, connection:
        connection.execute(statement, values)


def set_began(folder: Path, minute: int) -> None:
    """Let a run have begun in a minute of some hour: runs made in the same millisecond have no order."""
    began = f"2026-01-02T03:{minute:02}:00.000+00:00"
    alter_file(folder, "UPDATE meta SET value = ? WHERE key = 'created'", began)


def spoil_text(path: Path) -> None:
    path.write_text("configuration,arm\n" * 100)


def spoil_empty(path: Path) -> None:
    path.write_bytes(b"")


def spoil_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:50])


def spoil_header_only(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100])


def spoil_cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5000])


def spoil_middle(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[4096 : 4096 * 4] = random.Random(1).randbytes(4096 * 3)
    path.write_bytes(bytes(content))


def spoil_newer(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[60:64] = struct.pack(">I", 99)
    path.write_bytes(bytes(content))


def spoil_other(path: Path) -> None:
    path.unlink()
    alter_file(path.parent, "CREATE TABLE t (a)")


def spoil_tables(path: Path) -> None:
    alter_file(path.parent, "DROP TABLE meta")


def spoil_profile(path: Path) -> None:
    alter_file(path.parent, "UPDATE meta SET value = '{}' WHERE key = 'profile'")


SPOILED: tuple[tuple[Callable[[Path], None], str], ...] = (
    (spoil_text, "is not a run file"),
    (spoil_empty, r"is cut off \(0 bytes\)"),
    (spoil_short, r"is cut off \(50 bytes\)"),
    (spoil_header_only, "is cut off: 100 bytes of .* restore it from a copy"),
    (spoil_cut, "is cut off: .* restore it from a copy"),
    (lambda path: os.truncate(path, path.stat().st_size - 100), "is cut off: .* restore it from a copy"),
    (spoil_middle, "is damaged .* restore it from a copy"),
    (spoil_newer, r"newer cellapp \(schema 99, this one reads up to 11\); install the newer"),
    (spoil_other, "is an SQLite file, but not a run of cellapp"),
    (spoil_tables, "is damaged .*no such table"),
    (spoil_profile, "holds a profile that this cellapp cannot read"),
)
"""Each way to spoil a file, and what is said about it (a regular expression)."""


def two_arms() -> Profile:
    """Arm left with 2 joints, arm right with 3."""
    arms = {
        name: {
            "type": {"model": name, "joints": [{"d": 0.1, "a": 0.3}] * joints},
            "driver": {"kind": "none"},
            "smr": {"offset": "unknown"},
        }
        for name, joints in (("left", 2), ("right", 3))
    }
    return Profile.model_validate(
        {
            "schema": "cellapp-profile",
            "version": 1,
            "name": "two",
            "arms": arms,
            "tracker": {"driver": {"kind": "none"}},
        }
    )


def assert_same(first: Readings, second: Readings) -> None:
    """All that the two hold is the same, bit for bit (so that -0.0 is not 0.0, and NaN is NaN)."""
    for entry in fields(Readings):
        one, other = getattr(first, entry.name), getattr(second, entry.name)
        if isinstance(one, np.ndarray):
            assert isinstance(other, np.ndarray), entry.name
            assert (one.dtype, one.shape) == (other.dtype, other.shape), entry.name
            present = ~np.isnan(other)
            np.testing.assert_array_equal(~np.isnan(one), present, err_msg=entry.name)
            assert one[present].tobytes() == other[present].tobytes(), entry.name
        else:
            assert one == other, entry.name


def read_readings_csv(
    path: Path, joints: Mapping[str, int], *, in_order: bool = False, limits: Mapping[str, Array] | None = None
) -> tuple[dict[str, Readings], list[str]]:
    """The readings of each arm in a file, and notes."""
    readings, _, _, notes = arms_of_table(read_csv_table(path), joints, in_order, limits or {})
    return readings, notes


def import_csv(profile: Profile, csv: Path, folder: Path, *, in_order: bool = False) -> RunFile:
    """A new run of the readings in a file."""
    return RunFile.create(folder, profile, readings_from_csv(profile, csv, in_order=in_order))


def files(folder: Path) -> dict[str, bytes]:
    """All files below a folder, by their paths in it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
