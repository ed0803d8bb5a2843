"""Readings as CSV: export and import give every bit back; every bad file is refused with file, line and column."""

from __future__ import annotations

import csv
import json
import math
import shutil
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile, write_readings_csv
from cellapp.commands.stages import readings_digest
from cellapp.estimation.readings import Readings, joined
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import apply, invert, transform
from tests.approved import assert_refused
from tests.cell.run.small_runs import Rows, assert_same, import_csv, read_readings_csv, two_arms, written
from tests.cell.run.test_measured_again import change, left_alone
from tests.sure import sure
from tests.verbs import import_new_run

ROOT = Path(__file__).parents[3]
REAL = ROOT / "tests" / "fixtures" / "ur10-real" / "readings.csv"
JOINTS = {"left": 2, "right": 3}
HEADER = "configuration,arm,time_s,q1,q2,q3,x_m,y_m,z_m,sigma_m,split,mood"
ROWS = [
    "0,left,1.5,0.1,0.2,,1,2,3,1e-5,identify,good",
    "0,right,1.5,0.1,0.2,0.3,1,2,3.5,2e-5,identify,",
    "1,left,2.5,-0.1,0.25,,1,2,3,1e-5,train,bad",
    "1,right,2.5,0.1,0.2,-0.3,1,2,3.5,,validate,\"so, so\"",
]  # fmt: skip


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "readings.csv"


def write(path: Path, *rows: str, header: str = HEADER) -> None:
    path.write_text("\n".join([header, *rows]) + "\n", "utf-8")


def refusal(path: Path) -> str:
    """The message, after a look that neither reading nor importing leaves anything behind."""
    before = path.read_bytes() if path.is_file() else None
    with pytest.raises(InputError) as caught:
        read_readings_csv(path, JOINTS)
    run = path.parent / "run"
    with pytest.raises(InputError):
        import_csv(two_arms(), path, run)
    assert not run.exists()
    assert before is None or path.read_bytes() == before
    return str(caught.value)


def test_a_file_of_two_arms(path: Path) -> None:
    write(path, *ROWS)
    readings, notes = read_readings_csv(path, JOINTS)
    assert list(readings) == ["left", "right"]
    left, right = readings["left"], readings["right"]
    np.testing.assert_array_equal(left.q, [[0.1, 0.2], [-0.1, 0.25]])
    np.testing.assert_array_equal(right.q, [[0.1, 0.2, 0.3], [0.1, 0.2, -0.3]])
    np.testing.assert_array_equal(left.time_s, [1.5, 2.5])
    np.testing.assert_array_equal(right.sigma_m, [2e-5, np.nan])
    np.testing.assert_array_equal(left.approach, np.zeros((2, 2)))
    assert left.split == ("identify", "train")
    assert right.extras == {"mood": ("", "so, so")}
    assert left.payload_kg is None
    assert left.covariance_M is None
    assert notes == [f"{path}: column 'mood' is unknown; it is kept and not used"]


def test_what_is_optional_may_be_absent(path: Path) -> None:
    write(path, "5,left,1,2,3,4,5", header="configuration,arm,q1,q2,x_m,y_m,z_m")
    readings, notes = read_readings_csv(path, JOINTS)
    left = readings["left"]
    assert np.all(np.isnan(left.time_s))
    assert (left.payload_kg, left.temperature_c, left.joint_temperature_c, left.sigma_m) == (None, None, None, None)
    assert left.split is None
    assert left.extras == {}
    assert notes == [f"{path}: arm 'right' of the profile has no readings in this file"]


def test_spaces_byte_order_mark_blank_lines_and_windows_line_ends(path: Path) -> None:
    text = "\r\n".join([HEADER.replace(",", " , "), ROWS[0].replace(",", " , "), "", ROWS[2], "", ""])
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    readings, _ = read_readings_csv(path, JOINTS)
    assert len(readings["left"]) == 2


@pytest.mark.parametrize("name", ["csv", "quantities"])
def test_bad_cells_and_headers_are_named_as_approved(path: Path, name: str) -> None:
    """Words are replaced in a line of the file; what is said begins with file, line and column."""
    table = {"csv": (HEADER, *ROWS), "quantities": (HEADER_OF_QUANTITIES, *ROWS_OF_QUANTITIES)}[name]

    def spoilt(line: str, old: str, new: str) -> str:
        lines = list(table)
        assert old in lines[int(line) - 1]
        lines[int(line) - 1] = lines[int(line) - 1].replace(old, new, 1)
        write(path, *lines[1:], header=lines[0])
        return refusal(path)

    assert_refused(Path(__file__).parent / "approved" / f"bad-{name}.txt", spoilt, path.parent)


def test_a_header_of_one_column_tells_which_separator_is_expected(path: Path) -> None:
    write(path, header=HEADER.replace(",", ";"))
    assert refusal(path).startswith(f"{path}:1: the header is one column; separate columns by commas")


def test_a_covariance_is_six_numbers_and_positive_definite(path: Path) -> None:
    header = "configuration,arm,q1,q2,x_m,y_m,z_m,sxx,sxy,sxz,syy,syz,szz"
    good = "2.5e-10,1e-11,-2e-11,1e-10,3e-12,5e-12"
    # a tracker's beam 1:100 across, askew: hard, but positive definite
    askew = "5.0e-9,4.9995e-9,0,5.0e-9,0,1e-12"
    write(path, f"0,left,1,2,3,4,5,{good}", "1,left,1,2,3,4,5,,,,,,", f"2,left,1,2,3,4,5,{askew}", header=header)
    readings, _ = read_readings_csv(path, JOINTS)
    covariance = sure(readings["left"].covariance_M)
    np.testing.assert_array_equal(
        covariance[0], [[2.5e-10, 1e-11, -2e-11], [1e-11, 1e-10, 3e-12], [-2e-11, 3e-12, 5e-12]]
    )
    assert np.all(np.isnan(covariance[1]))

    def refused(six: str) -> str:
        write(path, f"0,left,1,2,3,4,5,{good}", f"1,left,1,2,3,4,5,{six}", header=header)
        return refusal(path)

    assert_refused(Path(__file__).parent / "approved" / "bad-covariances.txt", refused, path.parent)


def test_degrees_are_noticed_and_a_far_turned_joint_is_not_degrees(path: Path) -> None:
    header = "configuration,arm,q1,q2,x_m,y_m,z_m"
    write(path, "0,left,1,2,3,4,5", "1,left,90,2,3,4,5", "2,left,10,-45,3,4,5", header=header)
    assert refusal(path).startswith(f"{path}:3: q1: expected radians, got 90, and most rows are beyond two turns")
    write(path, "0,left,1,2,3,4,5", "1,left,13,2,3,4,5", "2,left,1,2,3,4,5", header=header)
    readings, _ = read_readings_csv(path, JOINTS)
    assert readings["left"].q[1, 0] == 13.0


@pytest.mark.parametrize(
    ("content", "where", "says"),
    [
        (b"", "", "is empty"),
        (HEADER.encode(), ":1", "there is a header row but no reading"),
        (HEADER.encode() + b"\n,,,,,,,,,,,\n", ":1", "there is a header row but no reading"),
        (HEADER.replace(",", ";").encode() + b"\n", ":1", "separate columns by commas"),
        (HEADER.encode() + b"\n\xff\xfe\n", "", "not UTF-8 text"),
        (HEADER.encode() + b'\n0,"left,1\n1,left\n', ":2", "not CSV"),
        (HEADER.encode() + b"\n" + b"1" * 200_000, ":2", "not CSV"),
        (b"SQLite format 3\x00" + bytes(100), "", ""),
    ],
)
def test_a_file_that_holds_no_readings(path: Path, content: bytes, where: str, says: str) -> None:
    path.write_bytes(content)
    message = refusal(path)
    assert message.startswith(f"{path}{where}")
    assert says in message


def test_a_missing_file_and_a_folder(path: Path) -> None:
    assert "file not found" in refusal(path)
    path.mkdir()
    assert "cannot be read" in refusal(path)


def test_a_text_is_no_formula_of_a_spreadsheet(path: Path, tmp_path: Path) -> None:
    rows = [row.replace("good", "=1+2").replace("bad", "-0.5") for row in ROWS]
    write(path, *rows)
    with import_csv(two_arms(), path, tmp_path / "run") as run:
        assert run.readings("left").extras["mood"] == ("=1+2", "-0.5")
        write_readings_csv(run, tmp_path / "out.csv")
    with (tmp_path / "out.csv").open(encoding="utf-8", newline="") as file:
        moods = [row["mood"] for row in csv.DictReader(file) if row["arm"] == "left"]
    assert moods == ["'=1+2", "-0.5"], "a number stays one"
    assert read_readings_csv(tmp_path / "out.csv", JOINTS)[0]["left"].extras["mood"] == ("=1+2", "-0.5")


NEAR = st.floats(-100.0, 100.0).filter(bool)
SIGMA = st.floats(1e-10, 0.01)
SECONDS = st.floats(-1e11, 1e11)


@st.composite
def some_readings(draw: st.DrawFn, joints: int, extras: tuple[str, ...]) -> Readings:
    n = draw(st.integers(1, 4))

    def column(elements: st.SearchStrategy[float], shape: int | tuple[int, ...]) -> np.ndarray | None:
        values = draw(hnp.arrays(np.float64, shape, elements=elements | st.just(math.nan)))
        return None if np.all(np.isnan(values)) else values

    covariance = None
    if draw(st.booleans()):
        roots = draw(hnp.arrays(np.float64, (n, 3), elements=st.floats(1e-9, 1e-3)))
        covariance = np.einsum("ni,ij,nj->nij", roots, np.eye(3) + 0.2, roots)
        covariance = np.triu(covariance) + np.swapaxes(np.triu(covariance, 1), 1, 2)
        covariance[draw(hnp.arrays(np.bool_, n))] = np.nan
        covariance = None if np.all(np.isnan(covariance)) else covariance
    split = draw(st.lists(st.sampled_from([None, "identify", "train", "validate"]), min_size=n, max_size=n))
    times = column(SECONDS, n)
    # any text that CSV can carry: all but the characters that cannot be encoded
    texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=6)
    numbers = draw(st.lists(st.integers(-(10**17), 10**17), min_size=n, max_size=n, unique=True))
    places = draw(st.none() | st.permutations(range(n)))
    return Readings(
        configuration=np.array(sorted(numbers), dtype=np.int64),
        sequence=None if places is None else np.array(places, dtype=np.float64),
        time_s=np.full(n, np.nan) if times is None else times,
        q=draw(hnp.arrays(np.float64, (n, joints), elements=st.floats(-12.5, 12.5))),
        approach=draw(hnp.arrays(np.int8, (n, joints), elements=st.integers(-1, 1))),
        p_M=draw(hnp.arrays(np.float64, (n, 3), elements=NEAR, unique=True)),
        payload_kg=column(st.floats(0.0, 1e4), n),
        temperature_c=column(NEAR, n),
        joint_temperature_c=column(NEAR, (n, joints)),
        step=column(NEAR, (n, joints)),
        dwell_s=column(st.floats(0.0, 1e11), n),
        covariance_M=covariance,
        sigma_m=column(SIGMA, n),
        split=tuple(split) if any(split) else None,
        extras={name: tuple(draw(st.lists(texts, min_size=n, max_size=n))) for name in extras},
    )


@settings(max_examples=50)
@given(data=st.data())
def test_export_then_import_gives_every_bit_back(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    extras = data.draw(st.sampled_from([(), ("note",), ("b", "a, \"quoted\"")]))  # fmt: skip
    arms = data.draw(st.sampled_from([("left",), ("left", "right")]))
    before = {arm: data.draw(some_readings(JOINTS[arm], extras)) for arm in arms}
    profile = two_arms()
    profile = profile.model_copy(update={"arms": {arm: profile.arms[arm] for arm in arms}})
    folder = tmp_path_factory.mktemp("bits")
    with RunFile.create(folder / "run", profile) as run:
        for arm, readings in before.items():
            run.add_readings(arm, readings)
        write_readings_csv(run, folder / "first.csv")
    with import_csv(profile, folder / "first.csv", folder / "again") as run:
        write_readings_csv(run, folder / "second.csv")
        assert run.arms() == list(before)
        for arm, readings in before.items():
            assert_same(run.readings(arm), readings)
    assert (folder / "second.csv").read_bytes() == (folder / "first.csv").read_bytes()
    shutil.rmtree(folder)


@settings(max_examples=50)
@given(content=st.text(alphabet='configuration,arm"qxyz_m123.\n-e5leftrigh', max_size=120))
def test_any_text_is_read_or_refused(content: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("any") / "file.csv"
    path.write_text(HEADER + "\n" + ROWS[0] + "\n" + content, "utf-8", newline="")
    try:
        readings, _ = read_readings_csv(path, JOINTS)
    except InputError as error:
        assert str(error).startswith(str(path))  # noqa: PT017
    else:
        assert len(readings["left"]) >= 1
    shutil.rmtree(path.parent)


def test_the_real_arm(tmp_path: Path) -> None:
    profile = load_profile(ROOT / "profiles" / "ur10-real.yaml")
    with import_csv(profile, REAL, tmp_path / "run") as run:
        readings = run.readings("left")
        write_readings_csv(run, tmp_path / "out.csv")
    assert len(readings) == 2773
    with REAL.open(newline="", encoding="utf-8") as file:
        given_rows = list(csv.DictReader(file))
    np.testing.assert_array_equal(
        readings.q, [[float(row[f"q{joint}"]) for joint in range(1, 7)] for row in given_rows]
    )
    np.testing.assert_array_equal(readings.p_M, [[float(row[f"{axis}_m"]) for axis in "xyz"] for row in given_rows])
    np.testing.assert_array_equal(readings.sigma_m, [float(row["sigma_m"]) for row in given_rows])
    assert np.all(np.isnan(readings.time_s))
    assert not readings.approach.any()
    again, notes = read_readings_csv(tmp_path / "out.csv", {"left": 6})
    assert notes == []
    assert_same(again["left"], readings)
    with (tmp_path / "out.csv").open(newline="", encoding="utf-8") as file:
        assert next(csv.reader(file)) == list(given_rows[0])


def test_joints_beyond_their_limits_are_refused_by_row_with_a_guess(tmp_path: Path, path: Path) -> None:
    """One row in degrees among rows in radians once ruined a calibration without a word."""
    rows = [f"{k},left,0.1,0.2,1,2,3" for k in range(5)]
    rows[2], rows[4] = "2,left,0.1,-55,1,2,3", "4,left,4000,0.2,1,2,3"
    rows += [f"{k},right,0.1,0.2,1,2,3" for k in range(5)]
    write(path, *rows, header="configuration,arm,q1,q2,x_m,y_m,z_m")
    limits = {"left": np.array([[-2.0 * np.pi, 2.0 * np.pi]] * 2)}
    with pytest.raises(InputError) as refused:
        read_readings_csv(path, {"left": 2, "right": 2}, limits=limits)
    first, second = str(refused.value).splitlines()
    expected = "expected -6.283 to 6.283 rad (limits of the joint) or one revolution more"
    assert first == f"{path}:4: q2: {expected}, got -55; degrees?"
    assert second == f"{path}:6: q1: {expected}, got 4000"
    far = [row.replace("-55", "12.5").replace("4000", "-12.5") for row in rows]
    write(path, *far, header="configuration,arm,q1,q2,x_m,y_m,z_m")
    readings, _ = read_readings_csv(path, {"left": 2, "right": 2}, limits=limits)
    assert readings["left"].q[2, 1] == 12.5


def test_absurd_and_non_finite_values_are_refused_by_row_as_approved(path: Path) -> None:
    """Lines name a line of the file, a column, and what stands there instead."""
    header = "configuration,arm,q1,q2,x_m,y_m,z_m,sigma_m,payload_kg,temperature_c,time_s,dwell_s,step1,step2"
    names = f"{header},joint_temperature1,joint_temperature2,approach1,approach2,sequence".split(",")
    good = ["left", "1", "2", "3", "4", "5", "1e-5", "2", "20", "7", "1", "0.1", "0.2", "30", "30", "-1", "+1"]
    limits = {"left": np.array([[-2.0 * np.pi, 2.0 * np.pi]] * 2)}

    def spoilt(line: str = "", column: str = "", value: str = "") -> dict[str, Readings]:
        rows = [names, *([str(k), *good, str(k)] for k in range(4))]
        if line:
            rows[int(line) - 1][names.index(column)] = value
        path.write_text("\n".join(map(",".join, rows)), "utf-8")
        return read_readings_csv(path, JOINTS, limits=limits)[0]

    np.testing.assert_array_equal(spoilt()["left"].approach, [[-1, 1]] * 4)
    assert_refused(Path(__file__).parent / "approved" / "bad-numbers.txt", spoilt, path.parent)


# -- Readings of two tracker stations through the one door: tied by reference nests, mistakes named by row -------------

T = transform(Rotation.from_euler("z", 1.2).as_matrix(), [2.0, -1.0, 0.2])
NESTS = np.array([[2.0, 1.5, -0.5], [3.5, -1.0, -0.5], [4.5, 1.0, -0.4], [3.0, 0.2, -0.6], [4.8, -1.2, 0.3]])
POINTS = np.random.default_rng(2).uniform(-0.8, 0.8, (12, 3)) + np.array([3.5, 0.0, 0.3])


def xyz(p: np.ndarray) -> dict[str, str]:
    return dict(zip(("x_m", "y_m", "z_m"), map(repr, p.tolist()), strict=True))


def readings() -> Rows:
    q = np.random.default_rng(4).uniform(-1.0, 1.0, (12, 6))
    back = apply(invert(T), POINTS)
    return [
        {
            "configuration": str(k),
            "arm": "left",
            **{f"q{j + 1}": repr(float(a)) for j, a in enumerate(q[k])},
            **xyz(POINTS[k] if k < 6 else back[k]),
            "station": "north" if k < 6 else "south",
        }
        for k in range(12)
    ]


def nests() -> Rows:
    noise = np.random.default_rng(5).normal(0.0, 1e-5, (2, 5, 3))
    rows = [{"station": "north", "nest": f"F{k}", **xyz(p)} for k, p in enumerate(NESTS + noise[0])]
    return rows + [
        {"station": "south", "nest": f"F{k}", **xyz(p)} for k, p in enumerate(apply(invert(T), NESTS) + noise[1])
    ]


def test_two_stations_are_one_frame_and_the_import_says_how_well(tmp_path: Path) -> None:
    table, floor = written(tmp_path / "in.csv", readings()), written(tmp_path / "floor.csv", nests())
    result = import_new_run(left_alone(), table, tmp_path / "run", reference_nests=floor)
    (note,) = (one for one in result.notes if one.startswith("station south is tied to north by 5 reference nests"))
    assert "a coordinate of arm left is known to 0.0" in note
    with RunFile.open(tmp_path / "run") as run:
        left = run.readings("left")
        assert run.rows("left").station == ("north",) * 6 + ("south",) * 6
    assert left.station is None
    np.testing.assert_allclose(left.p_M[:6], POINTS[:6], atol=1e-12)
    np.testing.assert_allclose(left.p_M[6:], POINTS[6:], atol=5e-5)


def test_stations_without_nests_are_refused(tmp_path: Path) -> None:
    table = written(tmp_path / "in.csv", readings())
    with pytest.raises(InputError, match=r"readings of 2 stations \(north, south\) have frames of their own"):
        import_new_run(left_alone(), table, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def drop(count: int) -> Callable[[Rows], None]:
    def act(rows: Rows) -> None:
        del rows[-count:]

    return act


def exchange(rows: Rows) -> None:
    rows[6]["nest"], rows[8]["nest"] = "F3", "F1"


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (drop(3), "station 'south' is not tied to 'north': measure three nests or more"),
        (change("x_m", "2.001", 0), "F0"),
        (change("nest", "F1", 5), r":8: nest: 'F1' of station 'south' is in line 7 already"),
        (change("y_m", "far", 3), r":5: y_m: expected a finite number such as 0.25, got 'far'"),
        (change("station", "", 3), r":5: station: the value is missing"),
        (exchange, "did it move, or are names exchanged"),
        (drop(5), "no nest of station south, which readings of arm left name"),
    ],
)
def test_a_mistake_is_named(tmp_path: Path, spoil: Callable[[Rows], None], says: str) -> None:
    rows = nests()
    spoil(rows)
    table, floor = written(tmp_path / "in.csv", readings()), written(tmp_path / "floor.csv", rows)
    with pytest.raises(InputError, match=says):
        import_new_run(left_alone(), table, tmp_path / "run", reference_nests=floor)
    assert not (tmp_path / "run").exists()


def test_a_stop_of_two_stations_is_named(tmp_path: Path) -> None:
    rows = readings()
    rows[6]["configuration"] = "2"
    table, floor = written(tmp_path / "in.csv", rows), written(tmp_path / "floor.csv", nests())
    with pytest.raises(InputError, match="give each station stops of its own"):
        import_new_run(left_alone(), table, tmp_path / "run", reference_nests=floor)


# -- All quantities of a reading as columns ----------------------------------------------------------------------------


HEADER_OF_QUANTITIES = (
    "configuration,arm,q1,q2,payload_kg,payload_cx_m,payload_cy_m,payload_cz_m,x_m,y_m,z_m,"
    "quat_w,quat_x,quat_y,quat_z,sigma_rad,smr,station"
)
ROWS_OF_QUANTITIES = (
    "0,left,0.1,0.2,2.5,0.01,0,0.05,1,2,3,0.5,0.5,-0.5,0.5,4e-05,A,north",
    "0,left,0.1,0.2,,,,,1,2,3,,,,,,B,north",
    "1,left,0.3,0.4,,,,,1,2,3,0.8,0,0.6,0,4e-05,A,south",
)


def written_of_quantities(path: Path, *rows: str, header: str = HEADER_OF_QUANTITIES) -> Path:
    path.write_text("\n".join([header, *rows]) + "\n", "utf-8")
    return path


def test_every_quantity_comes_back_bit_for_bit(tmp_path: Path) -> None:
    readings, notes = read_readings_csv(written_of_quantities(tmp_path / "in.csv", *ROWS_OF_QUANTITIES), {"left": 2})
    left = readings["left"]
    assert not notes
    assert left.smr == ("A", "B", "A")
    assert left.station == ("north", "north", "south")
    np.testing.assert_array_equal(sure(left.quaternion_M)[:2], [[0.5, 0.5, -0.5, 0.5], [np.nan] * 4])
    np.testing.assert_array_equal(sure(left.payload_center_F)[0], [0.01, 0.0, 0.05])
    with RunFile.create(tmp_path / "run", two_arms()) as run:
        run.add_readings("left", left)
        stored = run.rows("left")
        write_readings_csv(run, tmp_path / "out.csv")
    again, _ = read_readings_csv(tmp_path / "out.csv", {"left": 2})
    assert_same(stored, left)
    assert_same(again["left"], left)
    assert joined([left.take([0]), left.take([1, 2])]).smr == left.smr
    rotation = replace(left, rotation_covariance_M=np.tile(1e-9 * np.eye(3), (len(left), 1, 1)))
    both = sure(joined([rotation.take([0]), left.take([1, 2])]).rotation_covariance_M)
    np.testing.assert_array_equal(np.isfinite(both[:, 0, 0]), [True, False, False])


def test_a_quaternion_of_four_digits_gets_the_length_one(tmp_path: Path) -> None:
    rows = [row.replace("0.8,0,0.6,0", "0.7071,0,0.7071,0") for row in ROWS_OF_QUANTITIES]
    readings, _ = read_readings_csv(written_of_quantities(tmp_path / "in.csv", *rows), {"left": 2})
    found = sure(readings["left"].quaternion_M)
    np.testing.assert_allclose(found[2], [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0], atol=1e-15)


def test_a_component_that_has_no_column_is_named(tmp_path: Path) -> None:
    path = written_of_quantities(
        tmp_path / "in.csv", *ROWS_OF_QUANTITIES, header=HEADER_OF_QUANTITIES.replace("quat_z", "qz")
    )
    with pytest.raises(InputError, match="quat_z: the column is missing; give all of quat_w, quat_x, quat_y, quat_z"):
        read_readings_csv(path, {"left": 2})


UNREAD = ("tau1,tau2,current1,current2", ("10.5,-3.0,1.5,0.25", ",,,", "11.0,,,"))
HASH_BEFORE = "8879a20a4418201db55b6bbe25ac17f3fb7fb220de10912a6f53763bbfc83cdf"
"""Of these readings, when torques and currents were still read."""


def with_torques(path: Path) -> Path:
    cells = ("0,left,0.1,0.2,1,2,3", "1,left,0.1,0.3,1,2,3", "2,left,0.3,0.4,1,2,3")
    rows = [f"{row},{its}" for row, its in zip(cells, UNREAD[1], strict=True)]
    return written_of_quantities(path, *rows, header=f"configuration,arm,q1,q2,x_m,y_m,z_m,{UNREAD[0]}")


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


# -- Orientations as other programs write them -------------------------------------------------------------------------


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
    found = sure(readings["left"].quaternion_M)
    assert (Rotation.from_quat(found, scalar_first=True) * TURNS.inv()).magnitude().max() < 1e-7
    assert "of the probe's orientation in the tracker frame" in notes[0]
    assert not readings["left"].extras


def test_what_is_no_rotation_is_named_by_row_as_approved(tmp_path: Path) -> None:
    """Lines name columns of an orientation and what stands there in the second row."""

    def refused(names: str, row: str) -> object:
        values = FORMS.get(names, TURNS.as_rotvec())
        return read_readings_csv(table(tmp_path / "in.csv", names, values, row1=row), {"left": 2})

    assert_refused(Path(__file__).parent / "approved" / "bad-rotations.txt", refused, tmp_path)


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


# -- A new column of readings is one declaration -----------------------------------------------------------------------


def test_every_column_is_an_attribute_and_no_attribute_is_forgotten() -> None:
    names = {column.name for column in COLUMNS}
    beside = {"extras", "other_q"}  # not of a table's row
    assert names == set(Readings.__dataclass_fields__) - beside
    csv_names = [name for column in COLUMNS for name in column.csv_names(7)]
    assert len(csv_names) == len(set(csv_names))
