"""Orientations in a stranger's columns: understood where the names say what they are, else said what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.run.recorded_csv import converted, read_recorded
from cellapp.ground.errors import InputError
from tests.cell.run.csv_rows import read_readings_csv

TURNS = Rotation.from_rotvec([[0.3, -1.2, 2.0], [-0.4, 0.1, 0.9], [1.0, 0.2, -0.3]])
FORMS = {
    "qx,qy,qz,qw": TURNS.as_quat(),
    "o_w,o_x,o_y,o_z": TURNS.as_quat(scalar_first=True),
    "Rotation_vector_x [rad],Rotation_vector_y [rad],Rotation_vector_z [rad]": TURNS.as_rotvec(),
    "rotvec_x_deg,rotvec_y_deg,rotvec_z_deg": np.degrees(TURNS.as_rotvec()),
    "yaw_deg,pitch_deg,roll_deg": TURNS.as_euler("ZYX", degrees=True),
    "r11,r12,r13,r21,r22,r23,r31,r32,r33": TURNS.as_matrix().reshape(3, 9),
}


def table(path: Path, names: str, values: np.ndarray, **changed: str) -> Path:
    rows = [",".join(map(repr, row.tolist())) for row in values]
    rows = [changed.get(f"row{number}", row) for number, row in enumerate(rows)]
    head = f"configuration,arm,q1,q2,x_m,y_m,z_m,{names}"
    lines = [f"{number},left,0.{number},0.2,1,2,3,{row}" for number, row in enumerate(rows)]
    path.write_text("\n".join([head, *lines]) + "\n", "utf-8")
    return path


@pytest.mark.parametrize("names", list(FORMS))
def test_names_that_say_what_they_are_are_understood(names: str, tmp_path: Path) -> None:
    readings, notes = read_readings_csv(table(tmp_path / "in.csv", names, FORMS[names]), {"left": 2})
    found = readings["left"].quaternion_M
    assert found is not None
    assert (Rotation.from_quat(found, scalar_first=True) * TURNS.inv()).magnitude().max() < 1e-7
    assert "of the probe's orientation in the tracker frame" in notes[0]
    assert not readings["left"].extras


def test_a_line_of_comment_is_no_row(tmp_path: Path) -> None:
    path = table(tmp_path / "in.csv", "rotvec_x,rotvec_y,rotvec_z", TURNS.as_rotvec())
    path.write_text(path.read_text("utf-8") + "# measured by hand\n", "utf-8")
    assert len(read_readings_csv(path, {"left": 2})[0]["left"]) == 3


def test_empty_rows_have_no_orientation(tmp_path: Path) -> None:
    names = "rotvec_x,rotvec_y,rotvec_z"
    readings, _ = read_readings_csv(table(tmp_path / "in.csv", names, TURNS.as_rotvec(), row1=",,"), {"left": 2})
    assert readings["left"].quaternion_M is not None
    assert np.isnan(readings["left"].quaternion_M[:, 0]).tolist() == [False, True, False]


@pytest.mark.parametrize(
    ("names", "row", "words"),
    [
        ("qx,qy,qz,qw", "10,20,30,0", "are these angles in degrees?"),
        ("rotvec_x,rotvec_y,rotvec_z", "17,-69,115", "are these angles in degrees?"),
        ("rotvec_x,rotvec_y,rotvec_z", "1,,2", "rotvec_y: the value is missing; give all 3"),
        ("rotvec_x,rotvec_y,rotvec_z", "1,a,2", "rotvec_y: expected a finite number"),
        ("r11,r12,r13,r21,r22,r23,r31,r32,r33", "1,0,0,0,1,0,0,0,-1", "reflection"),
        ("r11,r12,r13,r21,r22,r23,r31,r32,r33", "1,0,0,0,1,0,0,0,0.9", "off unit length"),
    ],
)
def test_what_is_no_rotation_is_named_by_row(names: str, row: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"in\.csv:3: ") as refused:
        read_readings_csv(table(tmp_path / "in.csv", names, FORMS.get(names, TURNS.as_rotvec()), row1=row), {"left": 2})
    assert words in str(refused.value)


@pytest.mark.parametrize("names", ["qw,qx,qy,qz,qx", "qw,qx,qy,qz,sigma_m,sigma_m"])
def test_columns_beside_an_orientation_that_are_there_twice_are_named(names: str, tmp_path: Path) -> None:
    row = np.array([[1.0, 0.0, 0.0, 0.0, *[1e-5] * (names.count(",") - 3)]])
    with pytest.raises(InputError, match=f"{names.rsplit(',', 1)[1]}: the column is there twice"):
        read_readings_csv(table(tmp_path / "in.csv", names, row), {"left": 2})


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ("rx,ry,rz", "name them rotvec_x"),
        ("A [deg],B [deg],C [deg]", "name them rotvec_x"),
        ("roll,pitch,yaw", "write _deg or _rad"),
        ("qx,qy,qz", "a column for w is missing"),
    ],
)
def test_names_that_say_too_little_are_kept_with_a_note(names: str, words: str, tmp_path: Path) -> None:
    readings, notes = read_readings_csv(table(tmp_path / "in.csv", names, TURNS.as_rotvec()), {"left": 2})
    assert readings["left"].quaternion_M is None
    assert any(words in note for note in notes)
    assert list(readings["left"].extras) == names.split(",")


def test_a_table_of_ones_own_is_read_in_the_same_way(tmp_path: Path) -> None:
    path = tmp_path / "own.csv"
    rows = [f"{k * 10},20,{k},2,3,{','.join(map(repr, row))}" for k, row in enumerate(TURNS.as_euler("ZYX").tolist())]
    path.write_text("\n".join(["A1 [deg];A2 [deg];X;Y;Z;yaw_rad;pitch_rad;roll_rad", *rows]).replace(",", ";"), "utf-8")
    names, cells = converted(read_recorded(path), "deg", "m", "left")
    found = np.array([[float(row[names.index(f"quat_{axis}")]) for axis in "xyzw"] for row in cells])
    assert (Rotation.from_quat(found) * TURNS.inv()).magnitude().max() < 1e-7
    path.write_text(path.read_text("utf-8").replace("yaw_rad", "yaw").replace("pitch_rad", "pitch"), "utf-8")
    assert not any(name.startswith("quat_") for name in converted(read_recorded(path), "deg", "m", "left")[0])
