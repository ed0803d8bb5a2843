"""Answers become a profile: bases from tracker points, every wrong answer refused in a sentence that names its key."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run.recorded_csv import nobody
from cellapp.commands.init.answers import write_answers
from cellapp.commands.init.own_data import write_own_data
from cellapp.commands.init.request import InitRequest
from cellapp.commands.init.run import view
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Pose
from cellapp.robot.kinematics.chain import nominal_geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, invert, rotation_from_vector, transform
from cellapp.robot.model.nominal import nominal_arm, pose_matrix
from tests.approved import assert_approved
from tests.arms import UR5, UR10
from tests.cell.run.small_runs import import_csv
from tests.sure import sure
from tests.twin import PROFILES

APPROVED = Path(__file__).parent / "approved"
ANSWERS = """\
name: hall-3
arms:
  left:
    type: ur10
    driver: {kind: ur, host: 192.168.0.10}
    smr: {offset: [0.045, 0.020, 0.060]}
    home: [0, "-90 deg", 0, "-90 deg", 0, 0]
    base:
      points:
POINTS
tracker:
  driver: {kind: lmf, address: 192.168.0.1}
  pose: {position: [3.8, 0.0, 0.6], rpy: [0, 0, "180 deg"]}
plan: {stops: 200, floor: -0.15, clearance: "80 mm"}
"""
POSE = '  pose: {position: [3.8, 0.0, 0.6], rpy: [0, 0, "180 deg"]}\n'
TRUE_BASE = Pose(position=(0.1, 0.85, -0.02), rpy=(0.01, -0.02, 1.6))
TRACKER = Pose(position=(3.8, 0.0, 0.6), rpy=(0.0, 0.0, np.pi))
JOINTS = np.radians(
    [[0, -90, 0, -90, 0, 0], [80, -60, 70, 20, 40, 10], [-70, -100, -60, 0, 90, 50], [30, -30, 30, 0, 0, 0]]
)


def lines(*, joints: bool) -> str:
    """Four tracker points of an arm at ``TRUE_BASE``, known by joint positions or by coordinates."""
    arm = load_profile(PROFILES / "ur10-ur5.yaml").arms["left"]
    p_B = smr_positions(nominal_arm(arm), JOINTS)
    p_M = apply(invert(pose_matrix(TRACKER)) @ pose_matrix(TRUE_BASE), p_B)
    known = [f"joints: {q.tolist()}" if joints else f"base: {p.tolist()}" for q, p in zip(JOINTS, p_B, strict=True)]
    return "\n".join(f"        - {{{at}, tracker: {p.tolist()}}}" for at, p in zip(known, p_M, strict=True))


def written(folder: Path, text: str) -> Path:
    path = folder / "answers.yaml"
    path.write_text(text, "utf-8")
    return path


@pytest.mark.parametrize("joints", [True, False])
def test_answers_make_a_profile_with_the_surveyed_base(joints: bool, tmp_path: Path) -> None:
    result = write_answers(written(tmp_path, ANSWERS.replace("POINTS", lines(joints=joints))), tmp_path)
    path = Path(result.profile)
    assert path == tmp_path / "profiles" / "hall-3.yaml"
    profile = load_profile(path)
    base = sure(profile.arms["left"].base)
    assert np.allclose(pose_matrix(base), pose_matrix(TRUE_BASE), atol=1e-4)
    assert result.notes[0].startswith("arm left: 4 points fit to 0.00 mm rms")
    assert "# Base from tracker points, arm left: 4 points fit to" in path.read_text("utf-8")
    assert (tmp_path / "profiles" / "arms" / "ur10.yaml").is_file()


def refused(call: Callable[[], object], tmp_path: Path) -> str:
    """What a refusal says."""
    with pytest.raises(InputError) as caught:
        call()
    assert not (tmp_path / "profiles").exists()
    return str(caught.value).replace(f"{tmp_path}/", "")


def test_wrong_answers_are_refused_as_approved_and_nothing_is_written(tmp_path: Path) -> None:
    changes = [
        ("name: hall-3\n", ""),
        ("type: ur10", "type: ur11"),
        (", host: 192.168.0.10", ""),
        ("stops: 200", "stops: many"),
        ("stops: 200", "stop: 200"),
        ("plan:", "splits: {identfy: 3}\nplan:"),
        (POSE, ""),
        ("offset: [0.045, 0.020, 0.060]", "offset: unknown"),
        ("POINTS", "        - {tracker: [1, 2, 3]}"),
        ("POINTS", "        - {joints: [0], tracker: [1, 2, 3]}"),
        ("POINTS", "        - {base: [1, 2, 3], tracker: [1, 2]}"),
        ("POINTS", "        - {base: [0, 0, 0], tracker: [1, 2, 3]}"),
        ("      points:\n", "      position: [0, 0, 0]\n      points:\n"),
    ]
    said = []
    for old, new in changes:
        file = written(tmp_path, ANSWERS.replace(old, new, 1).replace("POINTS", lines(joints=True)))
        said.append(f"# {old.strip()} -> {new.strip()}\n{refused(partial(write_answers, file, tmp_path), tmp_path)}")
    assert_approved(APPROVED / "answers.txt", "\n".join(said))


def test_a_second_time_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, ANSWERS.replace("POINTS", lines(joints=False)))
    write_answers(path, tmp_path)
    with pytest.raises(InputError, match=r"hall-3\.yaml exists already; nothing was written"):
        write_answers(path, tmp_path)


def test_any_key_of_a_profile_is_an_answer_and_units_stay_as_written(tmp_path: Path) -> None:
    text = ANSWERS.replace("POINTS", lines(joints=False)) + "splits: {identify: 3}\nseed: 7\n"
    path = Path(write_answers(written(tmp_path, text), tmp_path).profile)
    profile = load_profile(path)
    assert (profile.seed, profile.splits.identify, profile.calibration.robust) == (7, 3, "huber")
    assert "clearance: 80 mm" in path.read_text("utf-8")


# -- From somebody's own table to a profile and a calibrated run: units, arm, messages; nothing is asked twice ---------

FIVE = np.array(
    [[0.0, 0.15, 0.03, np.pi / 2], [np.pi / 2, 0.0, 0.16, 0.0], [0.0, 0.0, 0.14, 0.0], [np.pi / 2, 0.0, 0.0, np.pi / 2],
     [0.0, 0.22, 0.0, 0.0]]
)  # fmt: skip


def simulated(rows: Array, n: int = 60, seed: int = 1) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    T_M_B = transform(rotation_from_vector(rng.normal(size=3)), rng.uniform(-2.0, 2.0, 3))
    q = rng.uniform(-2.5, 2.5, (n, len(rows)))
    p_M = smr_positions(nominal_geometry(rows, np.array([0.01, 0.02, 0.08]), T_M_B), q)
    return q, p_M + rng.normal(0.0, 1e-5, p_M.shape)


def own_data(file: Path, **known: Any) -> InitRequest:
    return InitRequest(**{"folder": file.parent, "readings": file, **known})


def table(path: Path, q: Array, p: Array, names: str = "", separator: str = ",", comma: str = ".") -> Path:
    header = names or ",".join([*(f"q{i + 1}" for i in range(q.shape[1])), "x", "y", "z"])
    lines = [separator.join(f"{v:.9f}".replace(".", comma) for v in (*a, *b)) for a, b in zip(q, p, strict=True)]
    path.write_text("\n".join([header, *lines]), "utf-8")
    return path


def test_a_german_table_becomes_a_run(tmp_path: Path) -> None:
    q, p_M = simulated(UR10)
    names = ";".join([*(f"A{i} [°]" for i in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"])
    file = table(tmp_path / "Meine Messung.csv", np.degrees(q), 1e3 * p_M, names, ";", ",")
    written = write_own_data(own_data(file, arm="ur10"))
    assert "decimal commas; joint positions in degrees, points in millimetres" in written.notes[0]
    assert written.notes[-1].endswith("arm, units and signs fit")
    profile = load_profile(Path(written.profile))
    assert (profile.name, list(profile.arms), profile.arms["robot"].driver.kind) == ("meine-messung", ["robot"], "none")
    with import_csv(profile, Path(sure(written.readings)), tmp_path / "run") as run:
        np.testing.assert_allclose(run.readings("robot").q, q, atol=1e-9)
        np.testing.assert_allclose(run.readings("robot").p_M, p_M, atol=1e-9)
    shown = view(written)
    assert str(shown.parts[-1]).startswith("next: cellapp import ")


def test_the_kinematics_decide_what_values_leave_open(tmp_path: Path) -> None:
    q, p_M = simulated(UR5)
    file = table(tmp_path / "r.csv", q + 2.0 * np.pi * (np.arange(6) == 5), p_M)  # beyond a revolution
    written = write_own_data(own_data(file, arm="ur5"))
    assert "joint positions in radians, points in metres" in written.notes[0]


def test_an_arm_that_is_not_named_is_asked_for_with_what_fits(tmp_path: Path) -> None:
    file = table(tmp_path / "r.csv", *simulated(UR5))
    with pytest.raises(InputError, match=r"which arm\? .*: ur5 \(0\.0 mm\), "):
        write_own_data(own_data(file), nobody)
    asked = []

    def choose(question: str, answers: tuple[str, ...]) -> str:
        asked.append((question, answers))
        return answers[0]

    written = write_own_data(own_data(file), choose)
    assert len(asked) == 1
    assert asked[0][1][0] == "ur5"
    assert load_profile(Path(written.profile)).arms["robot"].type.model == "UR5"


def test_a_wrong_arm_and_wrong_signs_are_told(tmp_path: Path) -> None:
    q, p_M = simulated(UR5)
    wrong = write_own_data(own_data(table(tmp_path / "r.csv", q, p_M), arm="ur10"))
    assert wrong.notes[-1].startswith("WARNING: ")
    assert wrong.notes[-1].endswith("the points fit ur5")
    turned = table(tmp_path / "t.csv", q * [1, -1, 1, 1, 1, 1], p_M)
    assert "with q2 with the opposite sign it leaves" in write_own_data(own_data(turned, arm="ur5")).notes[-1]


@pytest.mark.parametrize("modified", [False, True])
def test_d_h_rows_of_a_table(tmp_path: Path, modified: bool) -> None:
    rows = FIVE
    if modified:  # a and alpha of a row lie before its joint
        rows = np.column_stack([FIVE[:, :2], np.roll(FIVE[:, 2:], 1, axis=0)])
        rows[0, 2:] = 0.0
    cells = np.column_stack([np.degrees(rows[:, 0]), 1e3 * rows[:, 1], 1e3 * rows[:, 2], np.degrees(rows[:, 3])])
    text = "theta_deg,d_mm,a_mm,alpha_deg\n" + "\n".join(",".join(f"{v:.9f}" for v in row) for row in cells)
    (tmp_path / "my-arm.csv").write_text(text)
    file = table(tmp_path / "r.csv", *simulated(FIVE))
    written = write_own_data(own_data(file, arm=str(tmp_path / "my-arm.csv"), modified=modified))
    assert written.notes[-1].endswith("arm, units and signs fit")
    assert len(load_profile(Path(written.profile)).arms["robot"].type.joints) == 5


def test_wrong_rows_and_arms_are_refused_as_approved(tmp_path: Path) -> None:
    file = table(tmp_path / "r.csv", *simulated(FIVE))
    own = [
        *(own_data(table(tmp_path / "six.csv", *simulated(UR5)), arm=arm) for arm in ("ur99", "panda", "x.yaml")),
        own_data(table(tmp_path / "eight.csv", *simulated(np.tile(UR5[:1], (8, 1))))),
    ]
    header = "theta_deg,d_mm,a_mm,alpha_deg"
    for number, text in enumerate(
        ("theta,d,a,alpha\n0,0,0,0", header.replace("alpha_deg", "alpha_mm") + "\n0,0,0,0", header + "\n0,0,zero,0",
         header + "\n0,0,0,0")
    ):  # fmt: skip
        (tmp_path / f"rows-{number}.csv").write_text(f"{text}\n")
        own.append(own_data(file, arm=str(tmp_path / f"rows-{number}.csv")))
    said = [refused(partial(write_own_data, one), tmp_path) for one in own]
    assert_approved(APPROVED / "arms.txt", "\n".join(said))


def test_existing_files_stay(tmp_path: Path) -> None:
    file = table(tmp_path / "r.csv", *simulated(UR5))
    write_own_data(own_data(file, arm="ur5"))
    (tmp_path / "profiles" / "r.yaml").write_text("mine: yes\n")
    with pytest.raises(InputError, match="exists already"):
        write_own_data(own_data(file, arm="ur5"))
    assert (tmp_path / "profiles" / "r.yaml").read_text() == "mine: yes\n"


def test_joint_positions_of_a_motion_give_a_profile_for_recordings(tmp_path: Path) -> None:
    file = tmp_path / "joints.csv"
    file.write_text("time_s,q1,q2,q3,q4,q5,q6\n" + "0.0,0,0,0,0,0,0\n" * 3)
    with pytest.raises(InputError, match="which arm"):
        write_own_data(own_data(file))
    written = write_own_data(own_data(file, arm="ur5"))
    assert written.readings is None
    assert load_profile(Path(written.profile)).arms["robot"].smr.offset == "unknown"
    assert "--points" in Path(written.profile).read_text("utf-8")


def test_joints_and_points_of_a_motion_in_one_file_are_no_stops(tmp_path: Path) -> None:
    """Rows that follow one another in milliseconds are samples of a motion; minutes apart they are stops."""
    day = datetime(2026, 5, 3, 10)
    stamps = {
        "ms": (lambda n: f"{8.0 * n:g}", True),
        "minutes in ms": (lambda n: f"{60_000.0 * n:g}", False),
        "dates": (lambda n: (day + timedelta(milliseconds=8 * n)).isoformat(), True),
        "dates of stops": (lambda n: (day + timedelta(seconds=8 * n)).isoformat(), False),
    }
    for name, (stamp, motion) in stamps.items():
        rows = [f"{stamp(n)};0.{n:02d};1.2;0.4;2;1;0.{n:02d};1.{n:02d};2.5;0.1" for n in range(60)]
        file = tmp_path / f"both {name}.csv"
        file.write_text("\n".join(["t;J1;J2;J3;J4;J5;J6;X;Y;Z", *rows]) + "\n")
        own = own_data(file, folder=tmp_path / name, arm="ur5", angles="rad", lengths="m")
        written = write_own_data(own)
        assert (written.points == str(file)) is motion
        assert (written.readings is None) is motion
