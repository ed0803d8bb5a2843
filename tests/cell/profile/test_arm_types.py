"""The arm types of other makers: their D-H rows move the flange as the published axes do; nothing collides at rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile.loader import arm_type_of_text
from cellapp.cell.profile.starters import arm_type_files
from cellapp.ground.profile.schema import ArmType
from cellapp.ground.starters import starters_folder
from cellapp.robot.kinematics.chain import flange_poses, nominal_geometry
from cellapp.robot.kinematics.transforms import Array, rotation_from_vector, rotation_x, rotation_y

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


def test_joints_faster_than_600_degrees_a_second_are_taken() -> None:
    fastest = {name: max(joint.speed for joint in arm_type(name).joints) for name in ("lrmate-200id", "rx160")}
    assert min(fastest.values()) > np.radians(600.0)


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
