"""Recordings of other programs: names, separators, decimal commas and units that a file says, or that are sure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.run.columns import understood
from cellapp.cell.run.recordings_csv import read_recordings
from cellapp.ground.errors import InputError
from tests.cell.run.recorded_motion import joint_columns, point_columns
from tests.cell.run.two_arm_cell import two_arms

J, P = joint_columns(), point_columns()
STAMPS, Q, QD = J["time_s"], np.column_stack([J["q1"], J["q2"]]), np.column_stack([J["qd1"], J["qd2"]])
TIMES, POINTS = P["time_s"], np.column_stack([P["x_m"], P["y_m"], P["z_m"]])
SURE = Q + np.array([9.0, -9.0])  # further from zero in degrees than any joint in radians


def text_of(head: str, table: np.ndarray, separator: str = ",", *, comma: bool = False, end: str = "") -> str:
    """A header and rows, numbers in the shortest form that is exact."""
    rows = "".join(separator.join(map(repr, row)) + end + "\n" for row in table.tolist())
    return head + end + "\n" + (rows.replace(".", ",") if comma else rows)


def joints(*columns: np.ndarray) -> np.ndarray:
    return np.column_stack(columns)


FILES = {
    "RTDE": (
        text_of("timestamp target_q_0 target_q_1 actual_q_0 actual_q_1 actual_qd_0 actual_qd_1",
                joints(STAMPS, Q + 1.0, Q, QD), " "),
        text_of("Leica\nUnit: mm\n\nTime [s];X [mm];Y [mm];Z [mm]", joints(TIMES, 1e3 * POINTS), ";", comma=True),
    ),
    "degrees": (
        text_of("Time;Joint 1 [deg];Joint 2 [deg];Joint 1 speed [deg/s];Joint 2 speed [deg/s]",
                joints(STAMPS, np.degrees(Q), np.degrees(QD)), ";", end=";"),
        text_of("t\tpx\tpy\tpz", joints(TIMES, 1e3 * POINTS), "\t"),
    ),
    "units below the names": (
        text_of("# Robot\n# time,J1,J2,J1_vel,J2_vel", joints(STAMPS, np.degrees(Q) * 10, np.degrees(QD) * 10)),
        text_of("time|X|Y|Z\nms|mm|mm|mm", joints(1e3 * TIMES, 1e3 * POINTS), "|"),
    ),
    "nanoseconds since 1970": (
        text_of("%time,field.header.stamp,field.position0,field.position1,field.velocity0,field.velocity1",
                joints(1e9 * STAMPS, 1e9 * STAMPS, Q, QD)),
        text_of("timestamp,x,y,z,qw,qx,qy,qz", joints(1e9 * TIMES, POINTS, TIMES > 0.0, np.zeros((len(TIMES), 3)))),
    ),
    "joints of both in the file of points": (
        text_of("time_s,q1,q2,qd1,qd2", joints(STAMPS, Q, QD)),
        text_of("time_s,x_m,y_m,z_m,q1,q2", joints(TIMES, POINTS, POINTS[:, :2])),
    ),
}  # fmt: skip


def read(tmp_path: Path, joint_text: str, point_text: str):
    """The one recording of two texts, and what is said."""
    files = tmp_path / "joints.txt", tmp_path / "points.txt"
    for file, text in zip(files, (joint_text, point_text), strict=True):
        file.write_text(text, "utf-8")
    (one,), notes = read_recordings(two_arms(), [files[0]], [files[1]], "left")
    return one, notes


@pytest.mark.parametrize("case", FILES)
def test_files_of_other_programs_are_understood(case: str, tmp_path: Path) -> None:
    one, notes = read(tmp_path, *FILES[case])
    factor = 10.0 if case == "units below the names" else 1.0
    assert one.joints.columns["time_s"] == pytest.approx(STAMPS, abs=1e-6)
    assert one.points.columns["time_s"] == pytest.approx(TIMES, abs=1e-6)
    for number in (1, 2):
        assert one.joints.columns[f"q{number}"] == pytest.approx(factor * Q[:, number - 1], abs=1e-12)
        assert one.joints.columns[f"qd{number}"] == pytest.approx(factor * QD[:, number - 1], abs=1e-12)
    assert np.column_stack([one.points.columns[name] for name in ("x_m", "y_m", "z_m")]) == pytest.approx(POINTS)
    assert case.startswith("joints") or any("understood as time_s = " in note for note in notes)


def test_one_family_of_numbered_columns_are_the_joints() -> None:
    own = {"time_s", "q1", "q2", "q3", "q4"}
    traced = [f"AxisQMsr_LBR_7_R800_1[{number}]" for number in range(1, 8)]
    assert understood(("Zeit [ms]", *traced), "joints", own).names == ("time_s", *(f"q{n}" for n in range(1, 8)))
    assert understood(("t", *(f"Krc.{n} [deg]" for n in range(4))), "joints", own).factors["q4"] == np.pi / 180.0
    for other in ("tau_x1_", "b"):  # torques are none; of two families either may be
        names = ("t", *(f"{other}{n}" for n in range(4)), *(f"c{n}" for n in range(4 * (other == "b"))))
        assert not {"q1", "q2"} & set(understood(names, "joints", own).names)


def test_what_a_name_leaves_open_is_decided_only_where_it_is_sure(tmp_path: Path) -> None:
    points = text_of("time_s,x_m,y_m,z_m", joints(TIMES, POINTS))
    one, notes = read(tmp_path, text_of("t,A1,A2", joints(1e3 * STAMPS, np.degrees(SURE / 10))), points)
    assert one.joints.columns["q1"] == pytest.approx(SURE[:, 0] / 10)
    assert "stamps in milliseconds, by the step between them; joint positions in degrees, by their size" in notes[0]
    one, notes = read(tmp_path, text_of("t,A1,A2", joints(STAMPS, Q)), points)
    assert one.joints.columns["q1"] == pytest.approx(Q[:, 0])
    _, notes = read(tmp_path, text_of("t,target_q1,target_q2", joints(STAMPS, Q)), points)
    assert "positions that were commanded" in notes[0]


@pytest.mark.parametrize(
    ("head", "columns"),
    [("t,actual_q0,actual_q1,q0,q1", (Q, Q + 1.0)), ("time_s,q1,q2,actual_q_0,actual_q_1", (Q, Q + 1.0))],
)
def test_no_name_of_a_joint_is_given_twice(head: str, columns: tuple[np.ndarray, ...], tmp_path: Path) -> None:
    points = text_of("time_s,x_m,y_m,z_m", joints(TIMES, POINTS))
    one, _ = read(tmp_path, text_of(head, joints(STAMPS, *columns)), points)
    assert np.column_stack([one.joints.columns["q1"], one.joints.columns["q2"]]) == pytest.approx(Q)
    assert len(one.state.unknown) == 2


def test_stamps_may_be_dates_and_lost_beams_nan_or_zero(tmp_path: Path) -> None:
    rows = joints(TIMES, POINTS).tolist()
    clock = [f"2026-05-03T10:00:{row[0]:09.6f}" for row in rows]
    cells = [[stamp, *map(repr, row[1:])] for stamp, row in zip(clock, rows, strict=True)]
    cells = [[*row, "1", "0", "0", "0"] for row in cells]
    cells[0][1:], cells[7][1:], cells[9][1:] = ["NaN"] * 7, ["NaN"] * 7, ["0.0"] * 7
    text = "stamp;x;y;z;qw;qx;qy;qz\n" + "".join(";".join(row) + "\n" for row in cells)
    one, notes = read(tmp_path, text_of("time_s,q1,q2", joints(STAMPS, Q)), text)
    assert f"3 of {len(rows)} rows have no orientation" in notes[1]
    assert one.state.points.lost == 3
    kept = np.delete(TIMES, [0, 7, 9])
    assert np.diff(one.points.columns["time_s"]) == pytest.approx(np.diff(kept), abs=2e-6)


def test_data_frames_and_files_of_windows_are_read(tmp_path: Path) -> None:
    points = text_of("time_s,x_m,y_m,z_m", joints(TIMES, POINTS))
    frame = text_of(",time,q0,q1", joints(np.arange(len(STAMPS)), STAMPS, Q))
    one, notes = read(tmp_path, frame, points)
    assert one.joints.columns["q2"] == pytest.approx(Q[:, 1])
    assert any("'index' is unknown" in note for note in notes)
    title = text_of("Leica AT960;;;\nt;X;Y;Z", joints(TIMES, POINTS), ";")  # as spreadsheets fill a line up
    assert read(tmp_path, frame, title)[0].points.columns["z_m"] == pytest.approx(POINTS[:, 2])
    degrees = text_of("Zeit [s];A1 [°];A2 [°]", joints(STAMPS, np.degrees(Q)), ";", comma=True)
    for encoding in ("latin-1", "utf-16"):
        file = tmp_path / encoding
        file.write_bytes(degrees.encode(encoding))
        (one,), _ = read_recordings(two_arms(), [file], [tmp_path / "points.txt"], "left")
        assert one.joints.columns["q2"] == pytest.approx(Q[:, 1])


TURNS = Rotation.from_rotvec(np.outer(np.linspace(0.1, 1.0, len(TIMES)), [1.0, -0.5, 0.2]))
ORIENTATIONS = {
    "q0,q1,q2,q3": TURNS.as_quat(scalar_first=True),
    "field.orientation.x,field.orientation.y,field.orientation.z,field.orientation.w": TURNS.as_quat(),
    "rotvec_x_deg,rotvec_y_deg,rotvec_z_deg": np.degrees(TURNS.as_rotvec()),
    "Roll [deg],Pitch [deg],Yaw [deg]": TURNS.as_euler("xyz", degrees=True),
    "tool_qw,tool_qx,tool_qy,tool_qz,smr_qw,smr_qx,smr_qy,smr_qz": np.hstack(
        [np.tile([1.0, 0.0, 0.0, 0.0], (len(TIMES), 1)), TURNS.as_quat(scalar_first=True)]
    ),
}


@pytest.mark.parametrize("names", ORIENTATIONS)
def test_orientations_are_read_as_those_of_readings(names: str, tmp_path: Path) -> None:
    points = text_of(f"time_s,x_m,y_m,z_m,{names}", joints(TIMES, POINTS, ORIENTATIONS[names]))
    one, notes = read(tmp_path, text_of("time_s,q1,q2", joints(STAMPS, Q)), points)
    found = np.column_stack([one.points.columns[f"quat_{axis}"] for axis in "xyzw"])
    assert (Rotation.from_quat(found) * TURNS.inv()).magnitude().max() < 1e-7
    assert any("of the probe's orientation in the tracker frame" in note for note in notes)


def test_comments_between_and_below_the_rows_of_plain_files_are_no_rows(tmp_path: Path) -> None:
    lines = text_of("time_s,x_m,y_m,z_m,remark", joints(TIMES, POINTS)).splitlines()
    lines = [lines[0], *(f"{line},fine" for line in lines[1:])]
    text = "\n".join([*lines[:9], "# paused", *lines[9:], "# end, of the, recording, of the, tracker", "# Leica"])
    one, _ = read(tmp_path, text_of("time_s,q1,q2", joints(STAMPS, Q)) + "# end\n", text)
    assert one.points.columns["x_m"] == pytest.approx(POINTS[:, 0])
    assert one.points.words["remark"] == ("fine",)


SHORT = "t;x;y;z\n" + "1;2;3;4\n" * 9
BAD = {
    "swapped": (FILES["RTDE"][1], FILES["RTDE"][0], r"joints.txt:4: q1: .*this file has points: are .* swapped"),
    "no names": (text_of("1;2;3", joints(STAMPS, Q), ";"), FILES["RTDE"][1], r"joints.txt:1: there is no row of names"),
    "two clocks": (text_of("time,stamp,q1,q2", joints(STAMPS, STAMPS, Q)), FILES["RTDE"][1], r"time_s: .* rename the"),
    "short row": (FILES["RTDE"][0], "t;x;y;z\n" + "1;2;3;4\n" * 9 + "1;2;3\n", r"points.txt:11: the row has 3 cells"),
    "no time": (
        FILES["RTDE"][0],
        "t;x;y;z\n" + "10:00:01;2;3;4\n" * 9 + "error;2;3;4\n" + ";2;3;4\n",
        r"points.txt:11: time_s: expected a date with its time, or a time of day, got 'error'",
    ),
    "empty time": (FILES["RTDE"][0], "t;x;y;z\n" + "10:00:01;2;3;4\n" * 9 + ";2;3;4\n", r"txt:11: time_s: .* missing"),
    "stops with dates": (
        FILES["RTDE"][0],
        "t;x;y;z\n" + "".join(f"10:{n // 6:02d}:{10 * (n % 6):02d};{n};2;3\n" for n in range(30)),
        "time_s: the median step is 10; expected seconds, 2 to 20000 samples each$",
    ),
    "no number": (
        FILES["RTDE"][0],
        "t;x;y;z\n" + "1;2;3;4\n" * 9 + "1;2;a;4\n",
        r"points.txt:11: y_m: expected .* 'a'",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_not_clear_is_refused_where_it_is_wrong(case: str, tmp_path: Path) -> None:
    *texts, said = BAD[case]
    with pytest.raises(InputError, match=said):
        read(tmp_path, *texts)
