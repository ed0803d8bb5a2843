"""The one table of columns: a new quantity is one entry, and is then stored, exported and imported."""

from __future__ import annotations

import contextlib
import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.run import (
    RunFile,
    arm_cells,
    csv_export,
    csv_import,
    file,
    sqlite_file,
    write_readings_csv,
)
from cellapp.estimation.readings import Reading, Readings, readings
from cellapp.estimation.readings.columns import COLUMNS, Column, Fault
from cellapp.ground.errors import InputError
from tests.cell.run.csv_rows import import_csv, read_readings_csv
from tests.cell.run.small_runs import older_reading_table, two_arms


def above_zero(matrix: np.ndarray) -> Fault | None:
    wrong = np.argwhere(matrix < 0.0)
    return Fault(int(wrong[0, 0]), int(wrong[0, 1]), "expected a torque above 0 Nm") if len(wrong) else None


@dataclass(frozen=True, kw_only=True, eq=False)
class ToyReading(Reading):
    torque_nm: Any = None
    humidity: Any = None


@dataclass(frozen=True, kw_only=True, eq=False)
class ToyReadings(Readings):
    torque_nm: Any = None
    humidity: Any = None


@pytest.fixture
def toy_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    toys = (
        Column("torque_nm", "Nm", ("torque",), "joints", check=above_zero, since=2),
        Column("humidity", "", ("humidity",), fill=0.5, allowed=(0.25, 0.5, 0.75), expected="a quarter"),
    )
    for module in (readings, file, sqlite_file, arm_cells, csv_import, csv_export):
        monkeypatch.setattr(module, "COLUMNS", (*COLUMNS, *toys))
    monkeypatch.setattr(readings, "Readings", ToyReadings)


@pytest.mark.usefixtures("toy_columns")
def test_a_new_column_is_stored_exported_and_imported(tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "run", two_arms()) as run:
        run.add_stop(0, {"left": ToyReading(q=np.zeros(2), p_M=np.zeros(3), torque_nm=np.array([1.5, np.nan]))})
        run.add_stop(1, {"left": ToyReading(q=np.ones(2), p_M=np.ones(3), humidity=0.25)})
        run.add_stop(1, {"right": ToyReading(q=np.ones(3), p_M=np.ones(3))})
        stored: Any = run.readings("left")
        write_readings_csv(run, tmp_path / "out.csv")
    with contextlib.closing(sqlite3.connect(tmp_path / "run" / "run.sqlite")) as connection:
        rows = connection.execute("SELECT torque_nm, humidity FROM reading WHERE arm = 'left'").fetchall()
    assert rows == [("[1.5, null]", 0.5), (None, 0.25)]
    assert (tmp_path / "out.csv").read_text().splitlines()[0].endswith("torque1,torque2,torque3,humidity")
    with import_csv(two_arms(), tmp_path / "out.csv", tmp_path / "again") as run:
        imported: Any = run.readings("left")
        assert run.readings("right").torque_nm is None  # type: ignore[attr-defined]
    for found in (stored, imported):
        np.testing.assert_array_equal(found.torque_nm, [[1.5, np.nan], [np.nan, np.nan]])
        np.testing.assert_array_equal(found.humidity, [0.5, 0.25])


@pytest.mark.usefixtures("toy_columns")
def test_a_new_column_is_checked(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    path.write_text(
        "configuration,arm,q1,q2,x_m,y_m,z_m,torque1,torque2,humidity\n"
        "0,left,0,0,0,0,0,1,2,0.25\n"
        "1,left,0,0,0,0,0,1,-2,\n"
    )
    with pytest.raises(InputError, match=r"in\.csv:3: torque2: expected a torque above 0 Nm"):
        read_readings_csv(path, {"left": 2})
    path.write_text(path.read_text().replace("0.25", "0.3"))
    with pytest.raises(InputError, match=r"in\.csv:2: humidity: expected a quarter, got 0\.3"):
        read_readings_csv(path, {"left": 2})
    with RunFile.create(tmp_path / "run", two_arms()) as run, pytest.raises(ValueError, match="is not a quarter"):
        run.add_stop(0, {"left": ToyReading(q=np.zeros(2), p_M=np.zeros(3), humidity=0.3)})


@pytest.mark.usefixtures("toy_columns")
def test_an_older_file_without_the_column_gets_it_with_the_first_change(tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "run", two_arms()) as run:
        run.log("info", "made")
    with contextlib.closing(sqlite3.connect(tmp_path / "run" / "run.sqlite")) as connection:
        older_reading_table(connection, 1)
        connection.execute("ALTER TABLE reading DROP COLUMN torque_nm")
        for table in ("stage", "session", "request", "outcome", "reference", "recording", "stream"):
            connection.execute(f"DROP TABLE {table}")
        connection.execute("PRAGMA user_version=1")
        connection.commit()
    with RunFile.open(tmp_path / "run", write=True) as run:
        assert run.readings("left").torque_nm is None  # type: ignore[attr-defined]
        run.add_stop(0, {"left": ToyReading(q=np.zeros(2), p_M=np.zeros(3), torque_nm=np.array([1.0, 2.0]))})
        np.testing.assert_array_equal(run.readings("left").torque_nm, [[1.0, 2.0]])  # type: ignore[attr-defined]


def test_every_column_is_an_attribute_and_no_attribute_is_forgotten() -> None:
    names = {column.name for column in COLUMNS}
    beside = {"extras", "other_q"}  # not of a table's row
    assert names == set(Readings.__dataclass_fields__) - beside
    assert names - {"configuration"} == set(Reading.__dataclass_fields__) - {"extras"}
    csv_names = [name for column in COLUMNS for name in column.csv_names(7)]
    assert len(csv_names) == len(set(csv_names))
