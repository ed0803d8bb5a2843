"""Recorded files of other programs: what each column is, in which unit, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.cell.run.recorded_csv import converted, read_recorded
from cellapp.ground.errors import InputError

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


def test_the_columns_of_cellapp_and_others(tmp_path: Path) -> None:
    names = "configuration,arm,q1,q2,q3,x_m,y_m,z_m,sigma_m,split,qw,qx,qy,qz,remark"
    rows = [f"{i},left,{i},0.5,1.5,0.1,{i},0.3,1e-5,identify,1,0,0,0,fine" for i in range(4)]
    found = read_recorded(written(tmp_path, "\n".join([names, *rows])))
    assert found.arms == ("left",)
    header, cells = converted(found, "rad", "m", "robot")
    assert header == tuple(names.replace(",q", ",quat_").replace("quat_1,quat_2,quat_3", "q1,q2,q3").split(",")[:-1])
    assert cells[2][:3] == ("2", "left", "2")
    assert "remark" not in header


@pytest.mark.parametrize(
    ("q", "p", "angles", "lengths"),
    [
        (0.01 * Q, P, None, "m"),  # degrees, if the arm hardly moved
        (4.0 * Q, P, None, "m"),  # beyond a revolution, as some controllers count
        (Q, 1e-4 * P, "rad", None),
        (Q, 10.0 * P, "rad", None),
    ],
)
def test_what_is_not_sure_is_said_so(
    tmp_path: Path, q: np.ndarray, p: np.ndarray, angles: str | None, lengths: str | None
) -> None:
    found = read_recorded(written(tmp_path, text_of("q1,q2,q3,x,y,z", q, p)))
    assert (found.angles, found.lengths) == (angles, lengths)


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


def test_measured_columns_are_preferred_and_torques_are_not_used(tmp_path: Path) -> None:
    text = text_of("target_q_0,target_q_1,target_q_2,actual_q_0,actual_q_1,actual_q_2", Q + 1.0, Q)
    lines = text.replace("actual_q_2", "actual_q_2,x_um,y_um,z_um,tau_0,tau_1,tau_2").splitlines()
    rows = [f"{line},{','.join(map(repr, (1e6 * p).tolist()))},1,2,3" for line, p in zip(lines[1:], P, strict=True)]
    found = read_recorded(written(tmp_path, "\n".join([lines[0], *rows, "# end of the table"])))
    header, cells = converted(found, "rad", "um", "robot")
    assert header[2:] == ("q1", "q2", "q3", "x_m", "y_m", "z_m")
    assert found.unknown[-3:] == ("tau_0", "tau_1", "tau_2")
    np.testing.assert_allclose(np.array([row[2:8] for row in cells], dtype=float), np.hstack([Q, P]), atol=1e-9)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="file not found"):
        read_recorded(tmp_path / "none.csv")
