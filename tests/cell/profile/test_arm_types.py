"""The arm types of other makers: their D-H rows move the flange as the published axes do; nothing collides at rest."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.loader import arm_type_of_text, profile_from_json, profile_to_json
from cellapp.cell.profile.starters import arm_type_files
from cellapp.commands.doctor.view import cell_words, constraint_words
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import RENEWED
from cellapp.ground.profile.schema import ArmType
from cellapp.ground.starters import starters_folder
from cellapp.robot.kinematics.chain import flange_poses, nominal_geometry
from cellapp.robot.kinematics.transforms import Array, rotation_from_vector, rotation_x, rotation_y
from tests.approved import assert_refused
from tests.twin import PROFILES

Axes = list[tuple[tuple[float, float, float], tuple[float, float, float]]]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
MINUS_X, MINUS_Y, MINUS_Z = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)
FORWARD = rotation_y(np.pi / 2.0)
"""Flange of an arm whose wrist points along x at zero."""
PUBLISHED: dict[str, tuple[Axes, Array]] = {
    # origin of each joint's axis after the one before [m], and its direction, in the base frame at zero; ROS-Industrial
    # descriptions kuka_kr6_support, abb_irb120_support, fanuc_lrmate200id_support, staubli_rx160_support (BSD, Apache)
    "kr6-r900": (
        [((0, 0, 0.4), MINUS_Z), ((0.025, 0, 0), Y), ((0.455, 0, 0), Y), ((0, 0, 0.035), MINUS_X), ((0.42, 0, 0), Y),
         ((0.08, 0, 0), MINUS_X)],
        FORWARD,
    ),
    "irb120": (
        [((0, 0, 0), Z), ((0, 0, 0.29), Y), ((0, 0, 0.27), Y), ((0, 0, 0.07), X), ((0.302, 0, 0), Y),
         ((0.072, 0, 0), X)],
        FORWARD,
    ),
    "lrmate-200id": (
        [((0, 0, 0.33), Z), ((0.05, 0, 0), Y), ((0, 0, 0.33), MINUS_Y), ((0, 0, 0.035), MINUS_X),
         ((0.335, 0, 0), MINUS_Y), ((0.08, 0, 0), MINUS_X)],
        rotation_y(-np.pi / 2.0) @ rotation_x(np.pi),
    ),
    "rx160": (
        [((0, 0, 0.55), Z), ((0.15, 0, 0), Y), ((0, 0, 0.825), Y), ((0, 0, 0), Z), ((0, 0, 0.625), Y),
         ((0, 0, 0.11), Z)],
        np.eye(3),
    ),
    "lbr-iiwa14": (
        [((0, 0, 0.36), Z), ((0, 0, 0), Y), ((0, 0, 0), Z), ((0, 0, 0.42), MINUS_Y), ((0, 0, 0), Z),
         ((0, 0, 0.4), Y), ((0, 0, 0.126), Z)],
        np.eye(3),
    ),
}  # fmt: skip
PANDA_MODIFIED = np.array(
    [
        [0.0, 0.333, 0.0],
        [0.0, 0.0, -np.pi / 2],
        [0.0, 0.316, np.pi / 2],
        [0.0825, 0.0, np.pi / 2],
        [-0.0825, 0.384, -np.pi / 2],
        [0.0, 0.0, np.pi / 2],
        [0.088, 0.107, np.pi / 2],
    ]
)
"""a, d, alpha of the Panda by its maker's interface documentation (Craig's convention), flange in the last row."""


def arm_type(name: str) -> ArmType:
    path = starters_folder() / "arms" / f"{name}.yaml"
    return arm_type_of_text(path.read_text("utf-8"), path)


def flange_by_rows(name: str, q: Array) -> tuple[Array, Array]:
    rows = np.array([[joint.theta, joint.d, joint.a, joint.alpha] for joint in arm_type(name).joints])
    return flange_poses(nominal_geometry(rows, np.zeros(3)), q)


def flange_by_axes(axes: Axes, flange: Array, q: Array) -> tuple[Array, Array]:
    """One axis after the other, without any D-H."""
    rotation, position = np.eye(3), np.zeros(3)
    for (origin, axis), angle in zip(axes, q, strict=True):
        position = position + rotation @ np.array(origin)
        rotation = rotation @ rotation_from_vector(angle * np.array(axis))
    return rotation @ flange, position


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_rows_move_the_flange_as_the_published_axes_do(name: str) -> None:
    axes, flange = PUBLISHED[name]
    q = np.random.default_rng(3).uniform(-3.0, 3.0, (20, len(axes)))
    rotations, positions = flange_by_rows(name, q)
    base = rotation_x(np.pi) if axes[0][1] == MINUS_Z else np.eye(3)  # frame 0 stands along the first axis
    for one, rotation, position in zip(q, rotations, positions, strict=True):
        expected_rotation, expected_position = flange_by_axes(axes, flange, one)
        np.testing.assert_allclose(base @ position, expected_position, atol=1e-12)
        np.testing.assert_allclose(base @ rotation, expected_rotation, atol=1e-12)


def test_the_panda_is_the_published_one() -> None:
    q = np.random.default_rng(4).uniform(-2.0, 2.0, (20, 7))
    rotations, positions = flange_by_rows("panda", q)
    for one, rotation, position in zip(q, rotations, positions, strict=True):
        R, p = np.eye(3), np.zeros(3)
        for (a, d, alpha), angle in zip(PANDA_MODIFIED, one, strict=True):
            R = R @ rotation_x(alpha)
            p = p + R @ [a, 0.0, 0.0]
            R = R @ rotation_from_vector(np.array([0.0, 0.0, angle]))
            p = p + R @ [0.0, 0.0, d]
        np.testing.assert_allclose(position, p, atol=1e-12)
        np.testing.assert_allclose(rotation, R, atol=1e-12)


@pytest.mark.parametrize("path", arm_type_files(), ids=lambda path: path.stem)
def test_every_arm_type_is_complete(path: Path) -> None:
    found = arm_type_of_text(path.read_text("utf-8"), path)
    assert found.model
    assert found.source
    assert found.capsules
    assert all(joint.mass > 0.0 for joint in found.joints)
    assert "generic" not in found.model, "what is offered can be bought"


UR_PUBLISHED = {
    # d1, a2, a3, d4, d5, d6 [m], total mass [kg]; Universal Robots, "DH parameters for calculations of kinematics and
    # dynamics"
    "ur3e": ((0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921), 8.7985),
    "ur5e": ((0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996), 17.699),
    "ur10e": ((0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655), 29.104),
    "ur16e": ((0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655), 27.26),
    "ur20": ((0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543), 60.88),
}


@pytest.mark.parametrize("name", UR_PUBLISHED)
def test_arms_of_universal_robots_have_their_published_rows(name: str) -> None:
    found = arm_type(name)
    lengths, mass = UR_PUBLISHED[name]
    joints = found.joints
    assert tuple(joints[i].d for i in (0, 3, 4, 5)) == (lengths[0], *lengths[3:])
    assert (joints[1].a, joints[2].a) == lengths[1:3]
    assert sum(joint.mass for joint in joints) == pytest.approx(mass, abs=1e-3)
    np.testing.assert_allclose([joint.alpha for joint in joints], np.radians([90, 0, 0, 90, -90, 0]), atol=1e-12)
    reach = max(float(np.hypot(*capsule.start[:2])) for capsule in found.capsules)
    assert reach == pytest.approx(max(-lengths[1], -lengths[2]), abs=1e-9), "the upper arm's body is as long as its row"


# -- The section ``obstacles``: what it refuses, with file, line and key, and its words for people ---------------------


def written(folder: Path, *lines: str) -> Path:
    """The twin's profile with obstacles at its end."""
    text = (PROFILES / "twin.yaml").read_text("utf-8").replace("type: arms/", f"type: {PROFILES}/arms/")
    path = folder / "cell.yaml"
    path.write_text("\n".join([text, "obstacles:", *(f"  {line}" for line in lines), ""]), "utf-8")
    return path


ALL = (
    "table: {shape: box, size: [1.0, '500 mm', 0.04], pose: {position: [0.0, 0.0, -0.4]}}",
    "post: {shape: cylinder, radius: 0.1, length: 2.0, pose: {position: [-1.0, 0, 1], rpy: ['90 deg', 0, 0]}}",
    "lamp: {shape: sphere, radius: '50 mm', pose: {position: [0, 0, 2]}}",
    "hose: {shape: capsule, radius: 0.02, length: 0.1, fixed_to: flange, arm: right}",
    "plinth: {shape: box, size: [0.2, 0.2, 0.2], fixed_to: base, arm: left, pose: {position: [0, 0, -0.1]}}",
    "part: {shape: mesh, file: part.stl, scale: 0.001}",
)


def test_obstacles_are_read_and_kept_in_a_run(tmp_path: Path) -> None:
    (tmp_path / "part.stl").write_bytes(b"read by the gate, not here")
    profile = load_profile(written(tmp_path, *ALL))
    assert [one.shape for one in profile.obstacles.values()] == [
        "box", "cylinder", "sphere", "capsule", "box", "mesh"
    ]  # fmt: skip
    assert profile_from_json(profile_to_json(profile)) == profile
    words = dict(cell_words(profile))
    assert words["obstacle table"].startswith("box 1000 x 500 x 40 mm, in the cell: x 0.000, y 0.000, z -0.400 m")
    assert words["obstacle post"].startswith("cylinder of radius 100 mm, length 2000 mm, in the cell")
    assert "roll 90.0" in words["obstacle post"]
    assert words["obstacle hose"].startswith("capsule of radius 20 mm, length 100 mm, on the flange of arm right: ")
    assert words["obstacle plinth"].startswith("box 200 x 200 x 200 mm, on the base of arm left: ")
    assert words["obstacle lamp"].startswith("sphere of radius 50 mm, in the cell")
    assert words["obstacle part"].startswith(f"mesh {tmp_path / 'part.stl'}, scale 0.001, in the cell")
    assert "between arms, from 6 obstacles and from the floor" in dict(constraint_words(profile))["clearance"]


def test_bad_obstacles_are_named_with_their_line(tmp_path: Path) -> None:
    def refused(line: str) -> str:
        path = written(tmp_path, line)
        with pytest.raises(InputError) as caught:
            load_profile(path)
        number = len(path.read_text("utf-8").splitlines())
        return str(caught.value).replace(f"{path}:{number}: obstacles.", "").replace(f"{tmp_path}/", "")

    assert_refused(Path(__file__).parent / "approved" / "obstacles.txt", refused)


# -- Starter profiles: an empty folder gets a profile that loads; nothing that a person wrote is overwritten -----------


def test_an_installation_without_them_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.ground.starters.files", lambda package: tmp_path / package)
    with pytest.raises(InputError, match="lacks its starter profiles; install it again"):
        starters_folder()


def test_a_link_stays_a_link_and_permissions_stay(tmp_path: Path) -> None:
    file, link = tmp_path / "cell.yaml", tmp_path / "link.yaml"
    file.write_text("old\n", "utf-8")
    file.chmod(0o640)
    link.symlink_to(file)
    RENEWED.write_text(link, "new\n")
    assert link.is_symlink()
    assert file.read_text("utf-8") == "new\n"
    assert file.stat().st_mode & 0o777 == 0o640


def test_a_full_disk_leaves_the_old_file_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("old\n", "utf-8")

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left on device"):
        RENEWED.write_text(path, "new\n")
    assert [(entry.name, entry.read_text("utf-8")) for entry in tmp_path.iterdir()] == [("cell.yaml", "old\n")]
