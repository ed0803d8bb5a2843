"""Recordings of motion: what goes in comes out bit for bit; what cannot be one is refused with file, line, column."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cellapp.cell.run import RunFile
from cellapp.cell.run.columns import understood
from cellapp.cell.run.csv_export import write_recordings_csv
from cellapp.cell.run.csv_text import stamp_seconds
from cellapp.cell.run.recorded_csv import converted, read_recorded
from cellapp.cell.run.recordings import (
    packed,
    read_recordings_of,
    recording_states,
    recordings_digest,
    recordings_from_csv,
    unpacked,
)
from cellapp.cell.run.recordings_csv import read_recordings
from cellapp.ground.errors import InputError
from tests.cell.run.small_runs import (
    Columns,
    joint_columns,
    older_reading_table,
    point_columns,
    two_arms,
    write_columns,
)


@given(hnp.arrays(np.float64, hnp.array_shapes(min_dims=1, max_dims=1, min_side=0, max_side=50)))
def test_every_bit_of_a_column_comes_back(values: np.ndarray) -> None:
    assert unpacked(packed(values), len(values)).tobytes() == values.tobytes()


def test_damaged_columns_are_noticed() -> None:
    data = packed(np.arange(10.0))
    for spoiled in (data[:-4], b"", b"nothing"):
        with pytest.raises(ValueError, match=r"."):
            unpacked(spoiled, 10)
    with pytest.raises(ValueError, match=r"."):
        unpacked(data, 11)


def imported(tmp_path: Path, joints: Columns, points: Columns, arm: str | None = "left") -> RunFile:
    """A run of one recording."""
    files = ([write_columns(tmp_path / "a_j.csv", joints)], [write_columns(tmp_path / "a_p.csv", points)])
    _, fill = recordings_from_csv(two_arms(), *files, arm)
    return RunFile.create(tmp_path / "run", two_arms(), fill)


def test_a_recording_is_stored_and_exported_bit_for_bit(tmp_path: Path) -> None:
    joints, points = joint_columns(), point_columns()
    joints["voltage"] = 48.0 + joints["q1"]
    points["sigma_m"] = np.full(len(points["x_m"]), 2e-5)
    points["mood"] = ['"so, so"'] * len(points["x_m"])  # type: ignore[assignment]
    with imported(tmp_path, joints, points) as run:
        (state,) = recording_states(run)
        assert (state.arm, state.name, state.optional, state.unknown) == (
            "left",
            "a",
            ("qd", "sigma_m"),
            ("voltage", "mood"),
        )
        (found,) = read_recordings_of(run, "left")
        assert found.joints.qd is not None
        assert np.array_equal(found.joints.time_s, joints["time_s"])
        assert np.array_equal(found.joints.qd[:, 1], joints["qd2"])
        assert np.array_equal(found.points.p_M[:, 2], points["z_m"])
        assert read_recordings_of(run, "right") == ()
        assert found.points.held_out is None
        digest = recordings_digest(run, "left")
        for kind in ("joints", "points"):
            write_recordings_csv(run, kind, tmp_path / f"{kind}.csv")
    _, fill = recordings_from_csv(two_arms(), [tmp_path / "joints.csv"], [tmp_path / "points.csv"])
    with RunFile.create(tmp_path / "again", two_arms(), fill) as again:
        (copied,) = read_recordings_of(again, "left")
        assert copied.points.p_M.tobytes() == found.points.p_M.tobytes()
        assert copied.joints.q.tobytes() == found.joints.q.tobytes()
        (there,) = recording_states(again)
        assert (there.name, there.unknown) == ("a", ("voltage", "mood"))
        assert recordings_digest(again, "left")[0] == digest[0] == 2500


def refused(tmp_path: Path, joints: Columns, points: Columns, arm: str | None = "left") -> str:
    """What is said of files that are no recording."""
    files = ([write_columns(tmp_path / "j.csv", joints)], [write_columns(tmp_path / "p.csv", points)])
    with pytest.raises(InputError) as caught:
        read_recordings(two_arms(), *files, arm)
    return str(caught.value)


def _with(columns: Columns, name: str, row: int, value: object) -> Columns:
    cells = list(columns[name])
    cells[row] = value
    return {**columns, name: cells}  # type: ignore[dict-item]


BAD: dict[str, tuple[Callable[[Columns, Columns], tuple[Columns, Columns]], str]] = {
    "swapped": (lambda j, p: (p, j), r"j\.csv:1: q1: the column is missing; this file has points: .*swapped"),
    "degrees": (
        lambda j, p: ({**j, "q1": np.degrees(j["q1"]), "q2": np.degrees(j["q2"])}, p),
        r"j\.csv:\d+: q1: expected .* rad",
    ),
    "degrees, small": (
        lambda j, p: ({"time_s": j["time_s"], **{f"q{k}": 9.0 * np.sin(3.0 * j["time_s"]) for k in (1, 2)}}, p),
        r"j\.csv: q1: the joint rotates at .*degrees",
    ),
    "degrees a second": (
        lambda j, p: ({**j, "qd1": np.degrees(j["qd1"]), "qd2": np.degrees(j["qd2"])}, p),
        r"j\.csv: qd1: .*degrees a second",
    ),
    "millimetres": (
        lambda j, p: (j, {"time_s": p["time_s"], **{n: 1e3 * p[n] for n in ("x_m", "y_m", "z_m")}}),
        r"p\.csv:2: x_m: expected metres",
    ),
    "milliseconds": (
        lambda j, p: (j, {**p, "time_s": 1e3 * p["time_s"]}),
        r"p\.csv: time_s: the median step is 4; expected seconds.*milliseconds",
    ),
    "arm at rest": (
        lambda j, p: ({**j, "q1": 0.0 * j["q1"], "q2": 0.0 * j["q2"]}, p),
        r"j\.csv: q1\.\.: no joint moves by 0\.001 rad; .*, as qd1\.\. reach .* rad/s: give the joint positions",
    ),
    "SMR at rest": (
        lambda j, p: (j, {**p, **{name: 0.0 * p[name] + 1.0 for name in ("x_m", "y_m", "z_m")}}),
        r"p\.csv: x_m: the SMR does not move",
    ),
    "no number": (lambda j, p: (_with(j, "q2", 7, "fast"), p), r"j\.csv:9: q2: expected a finite number .* 'fast'"),
    "nan": (lambda j, p: (j, _with(p, "y_m", 3, "nan")), r"p\.csv:5: y_m: the value is missing; give all"),
    "nan of a joint": (lambda j, p: (_with(j, "q2", 3, "nan"), p), r"j\.csv:5: q2: the value is missing"),
    "infinite": (lambda j, p: (_with(j, "time_s", 3, "inf"), p), r"j\.csv:5: time_s: expected a finite number"),
    "empty": (lambda j, p: (_with(j, "q1", 4, ""), p), r"j\.csv:6: q1: the value is missing"),
    "half a point": (lambda j, p: (j, _with(p, "z_m", 4, "")), r"p\.csv:6: z_m: the value is missing; give all"),
    "sigma": (
        lambda j, p: (j, {**p, "sigma_m": np.where(np.arange(len(p["x_m"])) == 2, -1e-5, 1e-5)}),
        r"p\.csv:4: sigma_m: expected an uncertainty above 0",
    ),
    "quaternion": (
        lambda j, p: (j, {**p, **{f"quat_{a}": np.full(len(p["x_m"]), 0.6) for a in "wxyz"}}),
        r"p\.csv:2: quat_w: expected a unit quaternion, scalar first, got one of length 1\.2",
    ),
    "part of a quaternion": (
        lambda j, p: (j, {**p, "quat_w": np.ones(len(p["x_m"]))}),
        r"p\.csv:1: quat_x: the column is missing; give all",
    ),
    "too few joints": (
        lambda j, p: ({name: j[name] for name in ("time_s", "q1")}, p),
        r"j\.csv:1: q2: the column is missing; arm left has 2 joints",
    ),
    "too many joints": (lambda j, p: ({**j, "q3": j["q1"]}, p), r"j\.csv:1: q3: there are values, but arm left has 2"),
    "too few joints of the other arm": (
        lambda j, p: ({**j, "other_q1": j["q1"]}, p),
        r"j\.csv:1: other_q2: the column is missing; arm right has 3 joints",
    ),
    "degrees of the other arm": (
        lambda j, p: ({**j, **{f"other_q{k}": np.full(len(j["q1"]), 120.0) for k in (1, 2, 3)}}, p),
        r"j\.csv:2: other_q1: expected .* rad .*got 120; degrees\?",
    ),
    "part of the other arm": (
        lambda j, p: ({**j, **{f"other_q{k}": np.full(len(j["q1"]), [np.nan, 0.1][k < 3]) for k in (1, 2, 3)}}, p),
        r"j\.csv:2: other_q3: the value is missing; give all joints of the other arm in a row, or none",
    ),
    "other name": (
        lambda j, p: (j, {"time_of_day": p["time_s"], **{n: p[n] for n in ("x_m", "y_m", "z_m")}}),
        r"p\.csv:1: time_s: the column is missing; is 'time_of_day' meant\?.* the file has time_of_day, x_m, y_m, z_m",
    ),
    "no rows": (lambda j, p: (j, {name: np.empty(0) for name in p}), r"p\.csv:1: there is a header row but no sample"),
    "few rows": (lambda j, p: (j, {name: its[:5] for name, its in p.items()}), r"p\.csv: time_s: 5 rows are no"),
    "constant clock": (lambda j, p: (j, {**p, "time_s": 0.0 * p["time_s"]}), r"p\.csv: time_s: most stamps"),
    "split": (lambda j, p: (j, {**p, "split": ["test"] * len(p["x_m"])}), r"p\.csv:2: split: 'test' is no split"),  # type: ignore[dict-item]
    "arm": (lambda j, p: ({**j, "arm": ["top"] * len(j["q1"])}, p), r"j\.csv:2: arm: 'top' is not in the profile"),  # type: ignore[dict-item]
    "other recording": (
        lambda j, p: (
            {**j, "recording": ["a"] * len(j["q1"])},  # type: ignore[dict-item]
            {**p, "recording": ["b"] * len(p["x_m"])},  # type: ignore[dict-item]
        ),
        r"j\.csv: recording 'a' of arm left has no points",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_no_recording_is_refused_where_it_is_wrong(case: str, tmp_path: Path) -> None:
    spoil, said = BAD[case]
    message = refused(tmp_path, *spoil(joint_columns(), point_columns()))
    assert re.search(said, message), message


def test_which_arm_must_be_clear(tmp_path: Path) -> None:
    assert "which arm it is of; give --arm" in refused(tmp_path, joint_columns(), point_columns(), arm=None)
    assert "'top' is not in the profile" in refused(tmp_path, joint_columns(), point_columns(), arm="top")
    with pytest.raises(InputError, match=r"1 files of --joints, 0 of --points"):
        read_recordings(two_arms(), [tmp_path / "j.csv"], [], "left")
    pair = write_columns(tmp_path / "a_j.csv", joint_columns()), write_columns(tmp_path / "a_p.csv", point_columns())
    with pytest.raises(InputError, match=r"recording 'a' of arm left is there already .*a name of its own"):
        read_recordings(two_arms(), [pair[0]] * 2, [pair[1]] * 2, "left")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    good = write_columns(tmp_path / "p.csv", point_columns())
    binary = tmp_path / "j.csv"
    for content, said in (
        (b"\xff\xfe\x00time", "not UTF-8"),
        (b"", "is empty"),
        (b"time_s;q1\n1;2\n", "q2: the column is missing"),
        (b"1;2;3\n1;2;3\n", "no row of names above"),
        (b"time_s,q1,q2\n1,2\n", "q2: the row has 2 cells"),
        (b"time_s,q1,q2\n1,2,3\n0,5,2,3\n", r"csv:3: column 4: the row has 4 cells, the header has 3; write 0\.5"),
        (b"time_s,q1,q2\n1,2,3\n1,2,3,\n", "csv:3: column 4: the row has 4 cells"),
    ):
        binary.write_bytes(content)
        with pytest.raises(InputError, match=said):
            read_recordings(two_arms(), [binary], [good], "left")
    with pytest.raises(InputError, match="file not found"):
        read_recordings(two_arms(), [tmp_path / "none.csv"], [good], "left")


def test_a_run_of_an_older_schema_has_no_recordings_and_takes_some(tmp_path: Path) -> None:
    with imported(tmp_path, joint_columns(), point_columns()) as run:
        path = run.path
    with sqlite3.connect(path) as connection:
        older_reading_table(connection, 5)
        for table in ("recording", "stream"):
            connection.execute(f"DROP TABLE {table}")
        connection.execute("PRAGMA user_version=5")
    connection.close()
    with RunFile.open(path.parent, write=True) as older:
        assert recording_states(older) == ()
        _, fill = recordings_from_csv(two_arms(), [tmp_path / "a_j.csv"], [tmp_path / "a_p.csv"], "left")
        fill(older)
        assert len(recording_states(older)) == 1
        with pytest.raises(InputError, match="stored already"):
            fill(older)


def test_a_damaged_recording_is_named(tmp_path: Path) -> None:
    with imported(tmp_path, joint_columns(), point_columns()) as run:
        with run.change() as connection:
            connection.execute("UPDATE stream SET data = x'00' WHERE name = 'x_m'")
        with pytest.raises(InputError, match=r"damaged \(recording 'a' of arm left\)"):
            read_recordings_of(run, "left")


# -- Recorded files of other programs: what each column is, in which unit, and what is refused -------------------------

Q = np.array([[0.1, -1.2, 2.0], [1.4, -0.3, 1.1], [-2.2, 0.4, 0.9], [0.7, 1.9, -1.3]])
P = np.array([[0.4, -3.2, 0.2], [0.5, -3.1, 0.3], [0.1, -3.3, 0.1], [0.2, -2.9, 0.6]])


def text_of(names: str, q: np.ndarray, p: np.ndarray, separator: str = ",", comma: str = ".") -> str:
    rows = [
        separator.join(f"{v:.9f}".replace(".", comma) for v in (*one, *other)) for one, other in zip(q, p, strict=True)
    ]
    return "\n".join([names, *rows]) + "\n"


def written(tmp_path: Path, text: str, encoding: str = "utf-8") -> Path:
    path = tmp_path / "file.csv"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize(
    ("names", "separator"),
    [
        ("q1,q2,q3,x_m,y_m,z_m", ","),
        ("A1;A2;A3;X;Y;Z", ";"),
        ("joint_1\tjoint_2\tjoint_3\tsmr_x\tsmr_y\tsmr_z", "\t"),
        ("J1 J2 J3 px py pz", " "),
        ("Axis1|Axis2|Axis3|Tracker_X [m]|Tracker_Y [m]|Tracker_Z [m]", "|"),
        ("actual_q1 (rad);actual_q2 (rad);actual_q3 (rad);pos_x;pos_y;pos_z", ";"),
    ],
)
def test_names_and_separators_of_other_programs(tmp_path: Path, names: str, separator: str) -> None:
    found = read_recorded(written(tmp_path, text_of(names, Q, P, separator)))
    assert found.table.names == ("q1", "q2", "q3", "x_m", "y_m", "z_m")
    assert (found.joints, found.angles, found.lengths) == (("q1", "q2", "q3"), "rad", "m")
    header, rows = converted(found, "rad", "m", "robot")
    assert header == ("configuration", "arm", "q1", "q2", "q3", "x_m", "y_m", "z_m")
    assert rows[1][:2] == ("1", "robot")
    np.testing.assert_array_equal(np.array([row[2:] for row in rows], dtype=float), np.round(np.hstack([Q, P]), 9))


@given(st.sampled_from([";", "\t", " "]), st.sampled_from([",", "."]), st.booleans())
@settings(max_examples=12, deadline=None)
def test_degrees_millimetres_and_decimal_commas(
    tmp_path_factory: pytest.TempPathFactory, separator: str, comma: str, named: bool
) -> None:
    units = ("[deg]", "[mm]") if named else ("", "")
    names = separator.join([*(f"q{i}{units[0]}" for i in (1, 2, 3)), *(f"{axis}{units[1]}" for axis in "xyz")])
    text = "# by hand\n\n" + text_of(names, np.degrees(Q), 1e3 * P, separator, comma)
    found = read_recorded(written(tmp_path_factory.mktemp("recorded"), text, "utf-8-sig"))
    assert (found.angles, found.lengths, found.decimal_comma) == ("deg", "mm", comma == ",")
    assert found.table.lines[0] == 4
    rows = np.array([row[2:] for row in converted(found, "deg", "mm", "robot")[1]], dtype=float)
    np.testing.assert_allclose(rows, np.hstack([Q, P]), atol=2e-11)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty; expected a header row"),
        ("q1,x,y,z\n1,2,3,4\n", "at least 3 rows"),
        (text_of("1,2,3,4,5,6", Q, P), "there is no row of names above the first row of 6 numbers"),
        (text_of("q1,q2,q4,x,y,z", Q, P), "without a gap"),
        (text_of("a,b,c,x,y,z", Q, P), "expected columns such as q1"),
        (text_of("q1,q2,q3,x,y,w", Q, P), "z: expected a column such as z_mm"),
        (text_of("q1,q2,q3,x,px,z", Q, P), r"x_m: two columns seem to be it \(x, px\)"),
        (text_of("q1,q2,q3,x,y,z,qw,qx,qy,qz,qx", Q, np.hstack([P, P, P[:, :2]])), "qx: the column is there twice"),
        (text_of("q1_deg,q2_rad,q3,x,y,z", Q, P), "different units"),
        (text_of("q1_mm,q2_mm,q3_mm,x,y,z", Q, P), "expected columns such as q1, .* the file has q1_mm"),
        (text_of("q1,q2,q3,x_m,y_mm,z_m", Q, P), "columns x_m, y_mm, z_m have different units"),
        (text_of("q1,q2,q3,x,y,z", Q, P) + "1,2,3\n", "the row has 3 cells, the header has 6"),
        (text_of("q1,q2,q3,x,y,z", Q, P) + "1,2,nan,4,5,6\n", "file.csv:6: q3: expected a number, got 'nan'"),
        (text_of("q1,q2,q3,x,y,z", Q, P) + "1,2,1e999,4,5,6\n", "expected a number"),
        ("PK\x03\x04\x00\x00" * 9 + "\n1\n2\n3\n4", "not a text file"),
    ],
)
def test_files_that_cannot_be_understood(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words.replace("[", r"\[")):
        read_recorded(written(tmp_path, text))


# -- Recordings as other programs write them ---------------------------------------------------------------------------


J, P_STRANGE = joint_columns(), point_columns()
STAMPS, Q_STRANGE, QD = J["time_s"], np.column_stack([J["q1"], J["q2"]]), np.column_stack([J["qd1"], J["qd2"]])
TIMES, POINTS = P_STRANGE["time_s"], np.column_stack([P_STRANGE["x_m"], P_STRANGE["y_m"], P_STRANGE["z_m"]])


def columns_of(head: str, table: np.ndarray, separator: str = ",", *, comma: bool = False, end: str = "") -> str:
    """A header and rows, numbers in the shortest form that is exact."""
    rows = "".join(separator.join(map(repr, row)) + end + "\n" for row in table.tolist())
    return head + end + "\n" + (rows.replace(".", ",") if comma else rows)


def joints(*columns: np.ndarray) -> np.ndarray:
    return np.column_stack(columns)


FILES = {
    "RTDE": (
        columns_of("timestamp target_q_0 target_q_1 actual_q_0 actual_q_1 actual_qd_0 actual_qd_1",
                joints(STAMPS, Q_STRANGE + 1.0, Q_STRANGE, QD), " "),
        columns_of("Leica\nUnit: mm\n\nTime [s];X [mm];Y [mm];Z [mm]", joints(TIMES, 1e3 * POINTS), ";", comma=True),
    ),
    "degrees": (
        columns_of("Time;Joint 1 [deg];Joint 2 [deg];Joint 1 speed [deg/s];Joint 2 speed [deg/s]",
                joints(STAMPS, np.degrees(Q_STRANGE), np.degrees(QD)), ";", end=";"),
        columns_of("t\tpx\tpy\tpz", joints(TIMES, 1e3 * POINTS), "\t"),
    ),
    "units below the names": (
        columns_of(
            "# Robot\n# time,J1,J2,J1_vel,J2_vel", joints(STAMPS, *(10 * np.degrees(one) for one in (Q_STRANGE, QD)))),
        columns_of("time|X|Y|Z\nms|mm|mm|mm", joints(1e3 * TIMES, 1e3 * POINTS), "|"),
    ),
    "nanoseconds since 1970": (
        columns_of("%time,field.header.stamp,field.position0,field.position1,field.velocity0,field.velocity1",
                joints(1e9 * STAMPS, 1e9 * STAMPS, Q_STRANGE, QD)),
        columns_of("timestamp,x,y,z,qw,qx,qy,qz", joints(1e9 * TIMES, POINTS, TIMES > 0.0, np.zeros((len(TIMES), 3)))),
    ),
    "joints of both in the file of points": (
        columns_of("time_s,q1,q2,qd1,qd2", joints(STAMPS, Q_STRANGE, QD)),
        columns_of("note,time_s,x_m,y_m,z_m,q1,q2", joints(TIMES, POINTS, POINTS[:, :2])).strip().replace(
            "\n", '\n"text of\n# lines",') + "\n,,,,,,\n",
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
        assert one.joints.columns[f"q{number}"] == pytest.approx(factor * Q_STRANGE[:, number - 1], abs=1e-12)
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
    assert understood(("t", "Robot X [mm]", "Robot Y [mm]"), "points", own).commanded == ()


def test_stamps_may_be_dates_and_lost_beams_nan_or_zero(tmp_path: Path) -> None:
    rows = joints(TIMES, POINTS).tolist()
    clock = [f"2026-05-03T10:00:{row[0]:09.6f}" for row in rows]
    cells = [[stamp, *map(repr, row[1:])] for stamp, row in zip(clock, rows, strict=True)]
    cells = [[*row, "1", "0", "0", "0"] for row in cells]
    cells[0][1:], cells[7][1:], cells[9][1:] = ["NaN"] * 7, ["NaN"] * 7, ["0.0"] * 7
    text = "stamp;x;y;z;qw;qx;qy;qz\n" + "".join(";".join(row) + "\n" for row in cells)
    one, notes = read(tmp_path, columns_of("time_s,q1,q2", joints(STAMPS, Q_STRANGE)), text)
    assert f"3 of {len(rows)} rows have no orientation" in notes[1]
    assert one.state.points.lost == 3
    kept = np.delete(TIMES, [0, 7, 9])
    assert np.diff(one.points.columns["time_s"]) == pytest.approx(np.diff(kept), abs=2e-6)


def test_data_frames_and_files_of_windows_are_read(tmp_path: Path) -> None:
    points = columns_of("time_s,x_m,y_m,z_m", joints(TIMES, POINTS))
    frame = columns_of(",time,q0,q1", joints(np.arange(len(STAMPS)), STAMPS, Q_STRANGE))
    one, notes = read(tmp_path, frame, points)
    assert one.joints.columns["q2"] == pytest.approx(Q_STRANGE[:, 1])
    assert any("'index' is unknown" in note for note in notes)
    title = columns_of("Leica AT960;;;\nt;X;Y;Z", joints(TIMES, POINTS), ";")  # as spreadsheets fill a line up
    assert read(tmp_path, frame, title)[0].points.columns["z_m"] == pytest.approx(POINTS[:, 2])
    degrees = columns_of("Zeit [s];A1 [°];A2 [°]", joints(STAMPS, np.degrees(Q_STRANGE)), ";", comma=True)
    for encoding in ("latin-1", "utf-16"):
        file = tmp_path / encoding
        file.write_bytes(degrees.encode(encoding))
        (one,), _ = read_recordings(two_arms(), [file], [tmp_path / "points.txt"], "left")
        assert one.joints.columns["q2"] == pytest.approx(Q_STRANGE[:, 1])


BAD_STRANGE = {
    "swapped": (FILES["RTDE"][1], FILES["RTDE"][0], r"joints.txt:4: q1: .*this file has points: are .* swapped"),
    "no names": (
        columns_of("1;2;3", joints(STAMPS, Q_STRANGE), ";"),
        FILES["RTDE"][1],
        r"joints.txt:1: there is no row of names",
    ),
    "two clocks": (
        columns_of("time,stamp,q1,q2", joints(STAMPS, STAMPS, Q_STRANGE)),
        FILES["RTDE"][1],
        r"time_s: .* rename the",
    ),
    "short row": (FILES["RTDE"][0], "t;x;y;z\n" + "1;2;3;4\n" * 9 + "1;2;3\n", r"s.txt:11: z: the row has 3 cells"),
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


@pytest.mark.parametrize("case", BAD_STRANGE)
def test_what_is_not_clear_is_refused_where_it_is_wrong(case: str, tmp_path: Path) -> None:
    *texts, said = BAD_STRANGE[case]
    with pytest.raises(InputError, match=said):
        read(tmp_path, *texts)


NEW_YEAR_2026 = 1767225600.0
"""Its first second in UTC, since 1970."""


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("'01.01.2026 00:00:02,5", NEW_YEAR_2026 + 2.5),
        ("1/2/26 1:02:03 pm", NEW_YEAR_2026 + 86400.0 + 13 * 3600.0 + 123.0),  # the month comes first ...
        ("13/1/2026 12:00:00 AM", NEW_YEAR_2026 + 12 * 86400.0),  # ... where it can be one
        ("12/1/2026 12:00:00 PM", NEW_YEAR_2026 + 334 * 86400.0 + 12 * 3600.0),
        ("2026-01-01 01:00:00+01:00", NEW_YEAR_2026),
        ("01:02:03", 3723.0),
        ("1.1.2026 soon", np.nan),
        ("31.2.2026 00:00:00", np.nan),
    ],
)
def test_dates_and_times_of_day_are_seconds(text: str, seconds: float) -> None:
    np.testing.assert_equal(stamp_seconds(text), seconds)
