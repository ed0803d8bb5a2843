"""Files in the forms that other programs write: ``init``, its next command, and what then stands in the run."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import read_recordings_of
from cellapp.robot.kinematics.chain import flange_poses, smr_positions
from tests.arms import OFF_AXIS, UR5, Array, at_station, true_geometry
from tests.interfaces.cli.conftest import one_sentence

N = 40
RNG = np.random.default_rng(5)
ARM = true_geometry(at_station(UR5, OFF_AXIS), np.random.default_rng(1))
Q = RNG.uniform(-2.0, 2.0, (N, 6))
P = smr_positions(ARM, Q) + RNG.normal(0.0, 1e-5, (N, 3))
TURNED = flange_poses(ARM, Q)[0]  # of a probe that is aligned with the flange
DEG, MM = np.degrees(Q), 1e3 * P
ALPHABETICAL = ["elbow", "shoulder_lift", "shoulder_pan", "wrist_1", "wrist_2", "wrist_3"]
ORDER = [2, 1, 0, 3, 4, 5]


def numbered(pattern: str, first: int = 1, count: int = 6) -> list[str]:
    return [pattern.format(number) for number in range(first, first + count)]


def table(names: list[str], *columns: Any, separator: str = ",", head: str = "", end: str = "", quote: str = "") -> str:
    cells = [np.asarray(one).reshape(N, -1).astype(object) for one in columns]
    rows = [separator.join(f"{quote}{one}{quote}" for one in row) + end for row in np.hstack(cells).tolist()]
    return head + "\n".join([separator.join(names) + end, *rows]) + "\n"


def smr_places(*places_F: tuple[float, float, float]) -> Array:
    """Points (n, 3 k) in mm of SMRs at these places from the first one, in the flange frame."""
    return np.hstack([MM + 1e3 * TURNED @ np.array(one) + RNG.normal(0.0, 5e-3, (N, 3)) for one in places_F])


def disturbed() -> Array:
    found = smr_places((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0))
    found[7, 5] += 0.3
    return found


def written(values: Any, form: str) -> Any:
    """Each number as another program writes it: a format, and what replaces parts of it."""
    pattern, *replaced = form.split()
    texts = np.vectorize(lambda value: format(value, pattern))(values)
    for old, new in (one.split("=") for one in replaced):
        texts = np.char.replace(texts, old, new)
    return texts


def spherical(sense: float, zenith: float) -> tuple[Array, Array, Array]:
    """Range [mm], azimuth and the angle from the zenith (at 100) or from the horizon (at 0) [gon], each (n, 1)."""
    level, gon = np.hypot(*P[:, :2].T), 200.0 / np.pi
    up = gon * np.arctan2(P[:, 2], level)
    angles = sense * gon * np.arctan2(P[:, 1], P[:, 0]), zenith - up if zenith else up
    return np.linalg.norm(MM, axis=1)[:, None], angles[0][:, None], angles[1][:, None]


def lost() -> Array:
    found = MM.copy()
    found[3], found[9] = 0.0, found[8]
    return found


@dataclass
class Case:
    """A file, what ``init`` and ``import`` say of it, options, rows that are left out, a check of the readings."""

    text: str
    says: tuple[str, ...]
    options: tuple[str, ...] = ()
    without: tuple[int, ...] = ()
    check: Callable[[Any], bool] = lambda readings: True
    encoding: str = "utf-8"
    atol: float = 2e-8


PLAIN = [*numbered("J{}"), *"XYZ"]
J, XYZ = numbered("J{} [deg]"), ["X [mm]", "Y [mm]", "Z [mm]"]
CASES = {
    "measured behind nominal": Case(
        table([*numbered("J{}"), *"XYZ", "X meas", "Y meas", "Z meas"], DEG, MM + 1.0, MM),
        ("X meas = x_m", "kept and not used: X, Y, Z"),
    ),
    "nominal behind measured": Case(
        table([*J, *(f"{a} {b}" for a in ("Actual", "Nominal", "Dev") for b in "XYZ")], DEG, MM, MM + 1.0, 0 * MM),
        ("Actual X = x_m", "Dev X"),
    ),
    "which of two": Case(
        table([*J, *"xyz", "px", "py", "pz"], DEG, MM, MM + 1.0), ("x = x_m",), options=("--column", "x")
    ),
    "which of two letters": Case(
        table([*J, *(f"{axis}{kind}" for kind in "NA" for axis in "XYZ")], DEG, MM + 1.0, MM),
        ("XA = x_m", "kept and not used: XN"),
        options=("--column", "XA"),
    ),
    "counted from 0 and from 1": Case(
        table(
            [*numbered("actual_q_{}", 0), *numbered("target_q_{}"), *numbered("joint_temperature{}"),
             *numbered("current{}"), *"xyz"],
            Q, Q + 1.0, np.tile(np.arange(30.0, 36.0), (N, 1)), Q, P,
        ),
        ("actual_q_5 = q6", "current1"),
        check=lambda its: bool((its.joint_temperature_c == np.arange(30.0, 36.0)).all()) and "current6" in its.extras,
    ),
    "a T-Mac": Case(
        table(
            [*numbered("j{}"), "X  [mm]", "Y  [mm]", "Z  [mm]", "U(95)  [mm]", "U(95) X  [mm]", "U(95) Y  [mm]",
             "U(95) Z  [mm]", *numbered("Q{} ", 0, 4), "Image RMS  [µm]", "Temperature  [°C]", "Time Stamp"],
            DEG, MM, np.tile([0.004, 0.003, 0.001, 0.003], (N, 1)),
            Rotation.from_matrix(TURNED).as_quat(scalar_first=True), np.full(N, 0.3), np.full(N, 22.5),
            [f"'11.10.2022 15:{n:02d}:48.043" for n in range(N)],
        ),
        ("Q0, Q1, Q2, Q3: taken as a quaternion", "Time Stamp = time_s"),
        check=lambda its: bool(
            np.allclose(its.sigma_m, np.sqrt(19.0 / 3.0) / 2.0 * 1e-6)
            and np.allclose(its.time_s, 60.0 * np.arange(N), atol=1e-4)
            and (its.temperature_c == 22.5).all()
        ),
        encoding="latin-1",
    ),
    "a matrix from 0": Case(
        table(
            [*numbered("theta_{}"), *(f"m_{row}{column}" for row in range(4) for column in range(4))],
            Q, np.concatenate([np.dstack([TURNED, MM[:, :, None]]), np.tile([0, 0, 0, 1.0], (N, 1, 1))], axis=1),
        ),
        ("counted from 0 of the probe's orientation", "m_23 = z_m"),
        check=lambda its: np.allclose(Rotation.from_quat(its.quaternion_M, scalar_first=True).as_matrix(), TURNED),
    ),
    "a lost beam": Case(
        table([*J, *XYZ], DEG, lost()),
        ("own.csv:5: 0, 0, 0: the beam was lost", "again, at other joints than row 9", "arm, units and signs fit"),
        without=(3, 9),
    ),
    "three SMRs in a row": Case(
        table([*J, *(f"{axis}{smr}" for smr in (1, 2, 3) for axis in "XYZ")], DEG, disturbed()),
        ("SMRs 1, 2, 3", "three or more give a position and an orientation", "39 readings", "7 (0.1"),
        without=(7,), check=lambda its: its.quaternion_M is not None, atol=2e-5,
    ),
    "two SMRs in rows": Case(
        table(
            ["smr", *J, *XYZ], ["A", "B"] * (N // 2), np.repeat(DEG[::2], 2, axis=0),
            smr_places((0, 0, 0), (0.1, 0, 0))[::2].reshape(N, 3),
        ),
        ("two give no orientation: the next command takes A", "--smr A"), without=tuple(range(1, N, 2)), atol=2e-5,
    ),
    "stops with a time": Case(
        table(["configuration", "arm", "time_s", *numbered("q{}"), "x_m", "y_m", "z_m"],
              [[n, "left", 7.5 * n] for n in range(N)], Q, P),
        ("arm, units and signs fit",),
        check=lambda its: bool((its.time_s == 7.5 * np.arange(N)).all()),
    ),
    "joints in the order of their names": Case(
        table([*numbered("name{}", 0), *numbered("position{}", 0), *"xyz"],
              [[f"{name}_joint" for name in ALPHABETICAL]] * N, Q[:, ORDER], P),
        ("joints in the order of their names: shoulder_pan_joint, shoulder_lift_joint, elbow_joint",),
    ),
    "empty columns of a sheet": Case(table([*J, *XYZ], DEG, MM, separator=";", end=";;;"), ("by semicolons",)),
    "decimal commas between commas": Case(table([*J, *XYZ], written(np.hstack([DEG, MM]), '.7f .=,'), quote='"'), ()),
    "thousands with points": Case(
        table([*J, *XYZ], written(np.hstack([DEG, MM]), ",.7f ,=_ .=, _=."), separator=";"), ("decimal commas",)
    ),
    "thousands with commas": Case(table([*J, *XYZ], written(np.hstack([DEG, MM]), ",.7f"), separator="\t"), ()),
    "a sign of typesetters": Case(table([*J, *XYZ], written(np.hstack([DEG, MM]), ".7f -=\N{MINUS SIGN}")), ()),
    "Fortran": Case(table([*J, *XYZ], written(np.hstack([DEG, MM]), ".10e e=D")), ()),
    "its names again": Case(table([*J, *XYZ], DEG, MM).replace("\n", "\n" + ",".join([*J, *XYZ]) + "\n", 9), ()),
    "a comma behind each row": Case(table([*J, *XYZ], DEG, MM, end=",").replace(",\n", "\n", 1), ()),
    "units in cells": Case(
        table(PLAIN, np.char.add(written(DEG, ".7f"), "°"), np.char.add(written(MM, ".7f"), " mm")), ("J1 [°] = q1",)
    ),
    "units in words": Case(
        table([*PLAIN], DEG, MM).replace("Z\n", "Z\n" + 6 * "degrees," + "millimeters,millimeters,millimeters\n"), ()
    ),
    "lists in cells": Case(
        table(["joints", "tracker"], [list(map(str, both)) for both in zip(Q.tolist(), P.tolist())], quote='"'),
        ("joints 6 = q6", "tracker z = z_m"),
    ),
    "angles of an unknown order": Case(
        table([*J, *XYZ, "rx", "ry", "rz"], DEG, MM, 0.1 + 0 * MM), ("rx, ry, rz: not used as an orientation",),
        check=lambda its: its.quaternion_M is None,
    ),
    "inches": Case(table([*J, "X [in]", "Y [in]", "Z (inch)"], DEG, MM / 25.4), ("points in inches",)),
    "axes of Yaskawa": Case(table([*"SLURBT", *XYZ], DEG, MM), ("S = q1, L = q2, U = q3, R = q4, B = q5, T = q6",)),
    "robot beside tracker": Case(
        table([*numbered("q{}"), *(f"{axis}_{of}" for of in ("robot", "tracker") for axis in "xyz")], Q, P + 1.0, P),
        ("x_tracker = x_m", "kept and not used: x_robot"),
    ),
    "tolerances between coordinates": Case(
        table([*J, *(f"{of}{axis} [mm]" for axis in "XYZ" for of in ("", "±"))], DEG, np.repeat(MM, 2, axis=1)),
        ("kept and not used: ±X [mm]",),
    ),
    "no point": Case(
        table([*J, *XYZ], DEG, np.where(np.isin(np.arange(N), (3, 9))[:, None], "*****", written(MM, ".7f"))),
        ("own.csv:5, own.csv:11: ***** ***** ***** for a point: left out",), without=(3, 9),
    ),
    "names that are there again": Case(
        table([*PLAIN, *"XYZ"], DEG, MM + 1.0, MM), ("X (2) = x_m",), options=("--column", "X (2)")
    ),
    "commanded positions twice": Case(
        table([*numbered("q[{}]", 0), *2 * numbered("q_d[{}]", 0), *"xyz"], Q, Q + 1e-3, Q + 1e-3, P), ("q[5] = q6",)
    ),
    "joints in two units": Case(
        table([*J[:5], "J6 [rad]", *XYZ], DEG[:, :5], Q[:, 5:], MM), ("units that their names state: J1 [deg], J2",)
    ),
    "joints in milliradians": Case(table([*numbered("J{} [mrad]"), *XYZ], 1e3 * Q, MM), ("names state: J1 [mrad]",)),
    "a theodolite's angles": Case(
        table([*J, "Distance [mm]", "Hz [gon]", "zenith [gon]"], DEG, *spherical(-1.0, 100.0)),
        ("Distance [mm], Hz [gon], zenith [gon]: points by range, azimuth and zenith", "clockwise, as Hz"),
    ),
    "range, azimuth, elevation": Case(
        table([*J, "azimuth_gon", "elevation_gon", "range_mm"], DEG, *(spherical(1.0, 0.0)[k] for k in (1, 2, 0))),
        ("azimuth seen from above counter-clockwise",),
    ),
    "only the controller's points": Case(
        table([*numbered("actual_q_{}", 0), "TCP_X", "TCP_Y", "TCP_Z"], Q, smr_positions(at_station(UR5, OFF_AXIS), Q)),
        ("computed, not measured",), atol=1.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_table_of_another_program(name: str, call: Any) -> None:
    case = CASES[name]
    Path("own.csv").write_text(case.text, case.encoding)
    if case.options:
        one_sentence(call("init", "--readings", "own.csv", "--arm", "ur5"), "give the one that is: --column NAME")
    made = call("init", "my cell", "--readings", "own.csv", "--arm", "ur5", *case.options)
    assert made.code == 0, made.err
    _, *following = shlex.split(made.out.rpartition("next: ")[2])
    imported = call(*following)
    assert imported.code == 0, imported.err
    said = " ".join((made.out + imported.out).split())
    for words in case.says:
        assert words in said, said
    assert 'next: cellapp calibrate "my cell/logs/own"' in said
    with RunFile.open(Path("my cell/logs/own")) as run:
        (arm,) = run.arms()
        readings = run.readings(arm)
    kept = np.delete(np.arange(N), case.without)
    expected = (Q[::2], P[::2]) if "two SMRs" in name else (Q[kept], P[kept])
    np.testing.assert_allclose(readings.q, expected[0], atol=1e-9)
    np.testing.assert_allclose(readings.p_M, expected[1], atol=case.atol)
    assert case.check(readings)


PROGRAMS = {
    "ABB": "MODULE a\n  CONST jointtarget p1:=[[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\nENDMODULE\n",
    "KUKA": "DEF a()\nDECL E6AXIS XP1={A1 0.0,A2 -90.0,A3 90.0,A4 0.0,A5 0.0,A6 0.0}\nEND\n",
    "Fanuc": "/PROG A\n/POS\nP[1]{\n   GP1:\n  J1= 0.0 deg, J2= 0.0 deg, J3= 0.0 deg\n};\n/END\n",
    "Yaskawa": "/JOB\n//NAME A\n//POS\n///NPOS 1,0,0,0,0,0\nC00000=0,0,0,0,0,0\n",
    "JSON": '[{"q": [0, 0, 0, 0, 0, 0], "p": [1, 2, 3]}]\n',
    "YAML": "- q: [0, 0, 0, 0, 0, 0]\n  p: [1, 2, 3]\n",
}  # fmt: skip


@pytest.mark.parametrize("name", PROGRAMS)
def test_what_is_no_table_is_named(name: str, call: Any) -> None:
    Path("own.csv").write_text(PROGRAMS[name], "utf-8")
    one_sentence(call("init", "--readings", "own.csv", "--arm", "ur5"), name, "no table of joint positions and points")


@pytest.mark.parametrize(
    ("angle", "words"),
    [("V [gon]", "from the zenith or from the horizon?"), ("zenith", "expected its unit in its name")],
)
def test_an_angle_of_the_beam_that_may_be_two_is_asked(angle: str, words: str, call: Any) -> None:
    Path("own.csv").write_text(table([*J, "Distance [mm]", "Hz [gon]", angle], DEG, *spherical(-1.0, 100.0)), "utf-8")
    one_sentence(call("init", "--readings", "own.csv", "--arm", "ur5"), angle, words)


T = np.arange(0.0, 20.0, 0.008)
SWUNG = 0.5 * np.sin(np.outer(T, np.linspace(0.4, 0.9, 6)) + np.arange(6))
SEEN = smr_positions(ARM, SWUNG)
NS = 1_570_636_464_000_000_000
STAMPS = [f"{NS + int(1e9 * t)}" for t in T]
ARRIVED = [f"{NS + int(1e9 * (T[min(n // 42 * 42 + 41, len(T) - 1)])) + 40_000 * (n % 42)}" for n in range(len(T))]
LINES = {
    "names": ",".join([*numbered("field.name{}", 0), "field.header.stamp", *numbered("field.position{}", 0)]),
    "rows": [
        ",".join([*(f"{one}_joint" for one in ALPHABETICAL), stamp, *map(repr, q)])
        for stamp, q in zip(STAMPS, SWUNG[:, ORDER].tolist(), strict=True)
    ],
}
JOINTS = "\n".join([str(LINES["names"]), *LINES["rows"]])
AXES = "// SA 2024.2 ( x64 )\n// AXES = CARTESIAN: X,  Y,  Z (mm)\n"
STREAMS = {
    "bursts": (
        "\n".join(["field.header.stamp,x,y,z", *(f"{s},{x},{y},{z}" for s, (x, y, z) in zip(ARRIVED, SEEN.tolist()))]),
        ("stamps in nanoseconds, by their size", "came in 60 bursts, 0.336 s apart", "taken as measured evenly, 125 a"),
    ),
    "seconds and microseconds": (
        "\n".join(["sec usec x y z", *(f"{int(t)} {round(t % 1 * 1e6):d} {x} {y} {z}"
                                      for t, (x, y, z) in zip(T + 1e-9, SEEN.tolist()))]),
        ("time_s fraction = usec",),
    ),
    "SpatialAnalyzer": (
        AXES + "\n".join(f"Group,  P,  {n},  {x:.6f},  {y:.6f},  {z:.6f},  02/12/25 16:56:{t:09.6f}"
                         for n, (t, (x, y, z)) in enumerate(zip(T, (1e3 * SEEN).tolist()))),
        ("x_m = X [mm]",),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", STREAMS)
def test_a_recording_of_other_programs(name: str, call: Any) -> None:
    text, words = STREAMS[name]
    Path("joints.csv").write_text(JOINTS, "utf-8")
    Path("points.txt").write_text(text, "utf-8")
    one_sentence(call("init", "--readings", "points.txt", "--arm", "ur5"), "its next command takes these points")
    made = call("init", "my cell", "--readings", "joints.csv", "--arm", "ur5")
    _, *following = shlex.split(made.out.rpartition("next: ")[2])
    assert following[-4:] == ["--points", "points.txt", "--run", "my cell/logs/joints"]
    ended = call(*following)
    assert ended.code == 0, ended.err
    said = " ".join(ended.out.split())
    assert "q3 = field.position0, q2 = field.position1, q1 = field.position2" in said
    for one in words:
        assert one in said, said
    with RunFile.open(Path("my cell/logs/joints")) as run:
        (recording,) = read_recordings_of(run, "robot")
    np.testing.assert_allclose(recording.joints.q, SWUNG, atol=1e-12)
    np.testing.assert_allclose(np.diff(recording.points.time_s), np.diff(T), atol=1e-4)


def test_joints_alone_lead_to_the_chapter(call: Any) -> None:
    Path("joints.csv").write_text(JOINTS, "utf-8")
    assert call("init", "--readings", "joints.csv", "--arm", "ur5").out.endswith("next: cellapp docs readings\n")


def test_four_joints_counted_from_0(call: Any) -> None:
    """Their columns look like those of a quaternion."""
    np.savetxt("rows.csv", UR5[:4], delimiter=",", header="theta_rad,d_m,a_m,alpha_rad", comments="")
    arm = true_geometry(at_station(UR5[:4], OFF_AXIS), np.random.default_rng(1))
    points = smr_positions(arm, Q[:, :4])
    Path("own.csv").write_text(table([*numbered("q{}", 0, 4), *"xyz"], Q[:, :4], points), "utf-8")
    made = call("init", "--readings", "own.csv", "--arm", "rows.csv")
    assert "q0 = q1, q1 = q2, q2 = q3, q3 = q4" in " ".join(made.out.split())
    assert "arm, units and signs fit" in " ".join(made.out.split())


def test_tables_of_a_maker(call: Any) -> None:
    """The row of the flange behind those of the joints, and modified rows given as standard ones."""
    rows = np.vstack([np.column_stack([UR5[:, :2], np.roll(UR5[:, 2:], 1, axis=0)]), [0.0, 0.05, 0.0, 0.0]])
    np.savetxt("rows.csv", rows, delimiter=",", header="theta_rad,d_m,a_m,alpha_rad", comments="")
    Path("own.csv").write_text(table([*J, *XYZ], DEG, MM), "utf-8")
    wrong = " ".join(call("init", "a", "--readings", "own.csv", "--arm", "rows.csv").out.split())
    assert "row 7 of 6 joints is the flange (theta 0 deg, d 50 mm" in wrong
    assert "mm: give --modified" in wrong
    right = " ".join(call("init", "b", "--readings", "own.csv", "--arm", "rows.csv", "--modified").out.split())
    assert "arm, units and signs fit" in right


ANGLE = {0.0: "0", np.pi / 2.0: "π/2", -np.pi / 2.0: "-pi/2"}
DH_TABLES = {
    "a maker's page": (
        "Kinematics,theta [rad],a [m],d [m],alpha [rad]\n",
        lambda joint, theta, d, a, alpha: f"Joint {joint},{theta},{a},{d},{ANGLE[alpha]}",
    ),
    "a German sheet": (
        "theta [°];d [mm];a [mm];alpha [°]\n",
        lambda joint, theta, d, a, alpha: f"{theta};{1e3 * d:.3f};{1e3 * a:.3f};{np.degrees(alpha)}".replace(".", ","),
    ),
    "a paper": (
        "i|α_i|a_i|d_i|θ_i\n",
        lambda joint, theta, d, a, alpha: f"{joint}|{np.degrees(alpha)}°|{1e3 * a}|{1e3 * d}|θ{joint}",
    ),
}


@pytest.mark.parametrize("name", DH_TABLES)
def test_tables_of_d_h_rows(name: str, call: Any) -> None:
    head, row = DH_TABLES[name]
    lines = [row(joint, 0, *(float(one) for one in its[1:])) for joint, its in enumerate(UR5, start=1)]
    Path("rows.csv").write_text("\n".join([head.strip(), *lines]), "utf-8")
    Path("own.csv").write_text(table([*J, *XYZ], DEG, MM), "utf-8")
    said = " ".join(call("init", "a", "--readings", "own.csv", "--arm", "rows.csv").out.split())
    assert "arm, units and signs fit" in said
    assert ("theta in degrees, a in millimetres" in said or "by their size" in said) is (name == "a paper")


@pytest.mark.parametrize(("turns", "rows"), [(0.3, "motion"), (30.0, "stops"), (1.0, "")])
def test_rows_that_may_be_stops_or_a_motion(turns: float, rows: str, call: Any) -> None:
    """Stamps of 8000 without a unit: milliseconds from stop to stop, or microseconds from sample to sample."""
    phase = np.linspace(0.0, 2.0 * np.pi * turns, 60)[:, None]
    q = np.sin(phase + np.arange(6))
    lines = [
        ",".join(map(repr, one))
        for one in np.hstack([8000.0 * np.arange(60)[:, None], q, smr_positions(ARM, q)]).tolist()
    ]
    Path("own.csv").write_text("\n".join([",".join(["t", *numbered("J{}"), *"xyz"]), *lines]), "utf-8")
    ended = call("init", "--readings", "own.csv", "--arm", "ur5")
    if not rows:
        one_sentence(ended, "readings at stops, or samples of a motion? Give --rows stops or --rows motion")
        ended, rows = call("init", "--readings", "own.csv", "--arm", "ur5", "--rows", "stops"), "stops"
    assert ("--joints" in ended.out.rpartition("next: ")[2]) is (rows == "motion")
