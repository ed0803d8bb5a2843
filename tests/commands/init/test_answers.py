"""Answers become a profile: bases from tracker points, every wrong answer refused in a sentence that names its key."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.starters import SurveyPoint
from cellapp.commands.docs.handbook import chapter_text
from cellapp.commands.init.answers import surveyed_base, write_answers
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Pose
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import apply, invert
from cellapp.robot.model.nominal import nominal_arm, pose_matrix
from tests.twin import PROFILES

pytestmark = pytest.mark.fast

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
    assert result.path == tmp_path / "profiles" / "hall-3.yaml"
    profile = load_profile(result.path)
    base = profile.arms["left"].base
    assert base is not None
    assert np.allclose(pose_matrix(base), pose_matrix(TRUE_BASE), atol=1e-4)
    assert result.notes[0].startswith("arm left: 4 points fit to 0.00 mm rms")
    assert "# Base from tracker points, arm left: 4 points fit to" in result.path.read_text("utf-8")
    assert (tmp_path / "profiles" / "arms" / "ur10.yaml").is_file()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("name: hall-3\n", "", "name: missing; it must be given"),
        ("type: ur10", "type: ur11", r"arms\.left\.type: .*file not found"),
        (", host: 192.168.0.10", "", r"arms\.left\.driver\.host: missing; it must be given"),
        ("stops: 200", "stops: many", r"plan\.stops: expected a whole number, got 'many'"),
        ("stops: 200", "stop: 200", r"yaml:\d+: plan\.stop: unknown key; did you mean 'stops'"),
        ("plan:", "splits: {identfy: 3}\nplan:", r"splits\.identfy: unknown key; did you mean 'identify'"),
        (POSE, "", r"base\.points: tracker\.pose: missing"),
        ("offset: [0.045, 0.020, 0.060]", "offset: unknown", r"points: point 1: joint positions need the SMR offset"),
        ("POINTS", "        - {tracker: [1, 2, 3]}", r"points\[0\]: give 'base' .* or 'joints'"),
        ("POINTS", "        - {joints: [0], tracker: [1, 2, 3]}", "1: 1 joint positions for the 6 joints of UR10"),
        ("POINTS", "        - {base: [1, 2, 3], tracker: [1, 2]}", r"points\[0\]\.tracker"),
        ("POINTS", "        - {base: [0, 0, 0], tracker: [1, 2, 3]}", "1 points do not fix a base"),
        ("      points:\n", "      position: [0, 0, 0]\n      points:\n", "points: give points or a pose, not both"),
    ],
)
def test_a_wrong_answer_is_refused_and_nothing_is_written(old: str, new: str, words: str, tmp_path: Path) -> None:
    text = ANSWERS.replace(old, new, 1).replace("POINTS", lines(joints=True))
    with pytest.raises(InputError, match=words):
        write_answers(written(tmp_path, text), tmp_path)
    assert not (tmp_path / "profiles").exists()


def test_a_second_time_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, ANSWERS.replace("POINTS", lines(joints=False)))
    write_answers(path, tmp_path)
    with pytest.raises(InputError, match=r"hall-3\.yaml exists already; nothing was written"):
        write_answers(path, tmp_path)


def test_points_by_joints_and_by_coordinates_agree() -> None:
    arm = load_profile(PROFILES / "ur10-ur5.yaml").arms["left"]
    p_B = smr_positions(nominal_arm(arm), JOINTS).tolist()
    p_M = apply(invert(pose_matrix(TRACKER)) @ pose_matrix(TRUE_BASE), np.array(p_B)).tolist()
    by_joints = [SurveyPoint(tracker=m, joints=q) for q, m in zip(map(tuple, JOINTS.tolist()), p_M, strict=True)]
    by_place = [SurveyPoint(tracker=m, base=b) for b, m in zip(p_B, p_M, strict=True)]
    poses = [surveyed_base(arm, points, TRACKER).pose for points in (by_joints, by_place)]
    assert poses[0].position == pytest.approx(poses[1].position, abs=1e-12)
    assert poses[0].rpy == pytest.approx(TRUE_BASE.rpy, abs=1e-9)


def test_the_handbook_s_answers_make_a_profile(tmp_path: Path) -> None:
    blocks = re.findall(r"^```yaml\n(.*?)^```", chapter_text("cell"), re.M | re.S)
    (block,) = [part for part in blocks if "points:" in part]
    result = write_answers(written(tmp_path, block), tmp_path)
    assert result.path.name == "my-cell.yaml"
    assert result.notes[0].endswith("; good")


def test_any_key_of_a_profile_is_an_answer_and_units_stay_as_written(tmp_path: Path) -> None:
    text = ANSWERS.replace("POINTS", lines(joints=False)) + "splits: {identify: 3}\nseed: 7\n"
    path = write_answers(written(tmp_path, text), tmp_path).path
    profile = load_profile(path)
    assert (profile.seed, profile.splits.identify, profile.calibration.robust) == (7, 3, "huber")
    assert "clearance: 80 mm" in path.read_text("utf-8")
