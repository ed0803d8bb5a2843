"""Orientation, SMRs and stations of a reading: stored, exported bit for bit, refused by row."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.run import RunFile, write_readings_csv
from cellapp.commands.stages import readings_digest
from cellapp.estimation.readings import joined
from cellapp.ground.errors import InputError
from tests.cell.run.csv_rows import import_csv, read_readings_csv
from tests.cell.run.small_runs import assert_same, two_arms

HEADER = (
    "configuration,arm,q1,q2,payload_kg,payload_cx_m,payload_cy_m,payload_cz_m,x_m,y_m,z_m,"
    "quat_w,quat_x,quat_y,quat_z,sigma_rad,smr,station"
)
ROWS = (
    "0,left,0.1,0.2,2.5,0.01,0,0.05,1,2,3,0.5,0.5,-0.5,0.5,4e-05,A,north",
    "0,left,0.1,0.2,,,,,1,2,3,,,,,,B,north",
    "1,left,0.3,0.4,,,,,1,2,4,0.8,0,0.6,0,4e-05,A,south",
)


def written(path: Path, *rows: str, header: str = HEADER) -> Path:
    path.write_text("\n".join([header, *rows]) + "\n", "utf-8")
    return path


def test_every_quantity_comes_back_bit_for_bit(tmp_path: Path) -> None:
    readings, notes = read_readings_csv(written(tmp_path / "in.csv", *ROWS), {"left": 2})
    left = readings["left"]
    assert not notes
    assert left.smr == ("A", "B", "A")
    assert left.station == ("north", "north", "south")
    assert left.quaternion_M is not None
    np.testing.assert_array_equal(left.quaternion_M[:2], [[0.5, 0.5, -0.5, 0.5], [np.nan] * 4])
    assert left.payload_center_F is not None
    np.testing.assert_array_equal(left.payload_center_F[0], [0.01, 0.0, 0.05])
    with RunFile.create(tmp_path / "run", two_arms()) as run:
        run.add_readings("left", left)
        stored = run.rows("left")
        write_readings_csv(run, tmp_path / "out.csv")
    again, _ = read_readings_csv(tmp_path / "out.csv", {"left": 2})
    assert_same(stored, left)
    assert_same(again["left"], left)
    assert joined([left.take([0]), left.take([1, 2])]).smr == left.smr
    turning = replace(left, turning_covariance_M=np.tile(1e-9 * np.eye(3), (len(left), 1, 1)))
    both = joined([turning.take([0]), left.take([1, 2])]).turning_covariance_M
    assert both is not None
    np.testing.assert_array_equal(np.isfinite(both[:, 0, 0]), [True, False, False])


def test_a_quaternion_of_four_digits_gets_the_length_one(tmp_path: Path) -> None:
    rows = [row.replace("0.8,0,0.6,0", "0.7071,0,0.7071,0") for row in ROWS]
    readings, _ = read_readings_csv(written(tmp_path / "in.csv", *rows), {"left": 2})
    found = readings["left"].quaternion_M
    assert found is not None
    np.testing.assert_allclose(found[2], [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0], atol=1e-15)


@pytest.mark.parametrize(
    ("row", "old", "new", "column", "says"),
    [
        (0, "0.5,0.5,-0.5,0.5", "0.5,0.5,-0.5,0.4", "quat_w..quat_z", "expected a unit quaternion, scalar first, got"),
        (2, "0.8,0,0.6,0", "12.5,-30,90,0", "quat_w..quat_z", "are these angles in degrees?"),
        (2, "0.8,0,0.6,0", "0.8,0,,0", "quat_y", "the value is missing; give all four of the quaternion or none"),
        (0, "4e-05", "0.4", "sigma_rad", "expected 1e-09 to 0.1 rad, got 0.4; degrees or mrad?"),
        (0, "4e-05", "0", "sigma_rad", "expected 1e-09 to 0.1 rad, got 0"),
        (0, "0.01,0,0.05", "10.5,0,50", "payload_cx_m", "expected -10 to 10 m, got 10.5"),
        (1, ",B,", ",A,", "configuration", "give one row per stop, SMR and station"),
    ],
)
def test_a_bad_value_is_named_by_row(tmp_path: Path, row: int, old: str, new: str, column: str, says: str) -> None:
    rows = list(ROWS)
    assert old in rows[row]
    rows[row] = rows[row].replace(old, new, 1)
    path = written(tmp_path / "in.csv", *rows)
    with pytest.raises(InputError) as caught:
        import_csv(two_arms(), path, tmp_path / "run")
    assert str(caught.value).startswith(f"{path}:{row + 2}: {column}: ")
    assert says in str(caught.value)
    assert not (tmp_path / "run").exists()


def test_a_component_that_has_no_column_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "in.csv", *ROWS, header=HEADER.replace("quat_z", "qz"))
    with pytest.raises(InputError, match="quat_z: the column is missing; give all of quat_w, quat_x, quat_y, quat_z"):
        read_readings_csv(path, {"left": 2})


UNREAD = ("tau1,tau2,current1,current2", ("10.5,-3.0,1.5,0.25", ",,,", "11.0,,,"))
HASH_BEFORE = "8879a20a4418201db55b6bbe25ac17f3fb7fb220de10912a6f53763bbfc83cdf"
"""Of these readings, when torques and currents were still read."""


def with_torques(path: Path) -> Path:
    cells = ("0,left,0.1,0.2,1,2,3", "1,left,0.1,0.3,1,2,3", "2,left,0.3,0.4,1,2,3")
    rows = [f"{row},{its}" for row, its in zip(cells, UNREAD[1], strict=True)]
    return written(path, *rows, header=f"configuration,arm,q1,q2,x_m,y_m,z_m,{UNREAD[0]}")


def test_torques_and_currents_are_kept_and_not_used(tmp_path: Path) -> None:
    readings, notes = read_readings_csv(with_torques(tmp_path / "in.csv"), {"left": 2})
    assert notes[0].endswith("columns 'tau1', 'tau2', 'current1', 'current2' are unknown; they are kept and not used")
    assert readings["left"].extras["tau1"] == ("10.5", "", "11.0")
    assert readings_digest(readings["left"]) == HASH_BEFORE


def test_a_run_that_stored_torques_gives_them_back_and_keeps_its_hash(tmp_path: Path) -> None:
    readings, _ = read_readings_csv(with_torques(tmp_path / "in.csv"), {"left": 2})
    with RunFile.create(tmp_path / "run", two_arms()) as run:
        run.add_readings("left", replace(readings["left"], extras={}))
    with sqlite3.connect(tmp_path / "run" / "run.sqlite") as connection:
        for name, stem in (("tau_nm", "tau"), ("current_a", "current")):
            connection.execute(f"ALTER TABLE reading ADD COLUMN {name} TEXT")
            texts = zip(*(readings["left"].extras[f"{stem}{joint}"] for joint in (1, 2)), strict=True)
            for stop, its in enumerate(texts):
                cell = json.dumps([float(text) if text else None for text in its]) if any(its) else None
                connection.execute(f"UPDATE reading SET {name} = ? WHERE configuration = ?", (cell, stop))
        for table in ("reading", "earlier_reading"):
            for column in ("turning_covariance_rad2", "q_spread"):
                connection.execute(f"ALTER TABLE {table} DROP COLUMN {column}")
        connection.execute("PRAGMA user_version=9")
    connection.close()
    with RunFile.open(tmp_path / "run", write=True) as run:
        assert readings_digest(run.readings("left")) == HASH_BEFORE
        write_readings_csv(run, tmp_path / "out.csv")
        again, _ = read_readings_csv(tmp_path / "out.csv", {"left": 2})
        run.add_readings("left", replace(readings["left"].take([0]), configuration=np.array([7]), extras={}))
        assert run.readings("left").extras["tau1"] == ("10.5", "", "11.0", "")
    assert again["left"].extras == readings["left"].extras
