"""Goals: one physical point given in every frame leads to the same place; nominal bases move what rests on a base."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cellapp.cell.targets.goals import ArmGoals, goals_of_arm, work_frame_pose
from cellapp.cell.targets.targets import FramePoint, Partner, Target, WorkFrame
from cellapp.estimation.discovery.plan_forecast import nominal_model
from cellapp.robot.kinematics.transforms import Array, apply, invert, rotation_zyx, transform, zyx_angles
from cellapp.robot.model import ArmModel, CellModel
from tests.twin import small_twin

_AT_M = 1e-12
"""Rounding of a few transforms of coordinates of some metres."""


def _moved_base(arm: ArmModel) -> ArmModel:
    """The arm with its calibrated base some millimetres and milliradians off the nominal one."""
    offset = transform(rotation_zyx(2e-3, -1e-3, 3e-3), [4e-3, -2e-3, 1e-3])
    return dataclasses.replace(arm, geometry=arm.nominal.with_T_M_B(offset @ arm.nominal.T_M_B()))


PROFILE = small_twin()
MODEL = CellModel({name: _moved_base(nominal_model(PROFILE, name)) for name in PROFILE.arms})

coordinates = st.floats(-5.0, 5.0)
points = st.tuples(coordinates, coordinates, coordinates)
quaternions = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
poses = st.builds(lambda p, q: transform(Rotation.from_quat(q).as_matrix(), p), points, quaternions)


def target_at(name: str, T: Array, **keys: object) -> Target:
    """A target of the left arm at a pose (4, 4) in its frame."""
    yaw, pitch, roll = zyx_angles(T[:3, :3])
    keys |= {"name": name, "arm": "left", "position": T[:3, 3].tolist(), "rpy": (roll, pitch, yaw)}
    return Target.model_validate(keys)


def work_frame(T_parent_W: Array, parent: str) -> WorkFrame:
    nominal = np.array([[0.0, 0.0, 0.0], [0.7, 0.0, 0.1], [0.0, 0.4, 0.0], [0.3, 0.2, -0.5]])
    return WorkFrame(
        name="fixture",
        parent=parent,
        points=tuple(
            FramePoint(nominal=tuple(at), measured=tuple(there))
            for at, there in zip(nominal.tolist(), apply(T_parent_W, nominal).tolist())
        ),
    )


def everywhere(T_M_S: Array, T_M_W: Array) -> list[Target]:
    """One physical pose (4, 4) in the tracker frame as a target in every kind of frame."""
    bases = {name: arm.geometry.T_M_B() for name, arm in MODEL.arms.items()}
    on_left = work_frame(invert(bases["left"]) @ T_M_W, "left")
    in_tracker = work_frame(T_M_W, "tracker")
    in_work_frame = invert(T_M_W) @ T_M_S
    return [
        target_at("tracker", T_M_S, frame="tracker"),
        target_at("own base", invert(bases["left"]) @ T_M_S),
        target_at("own base by name", invert(bases["left"]) @ T_M_S, frame="left"),
        target_at("other base", invert(bases["right"]) @ T_M_S, frame="right"),
        target_at("work frame", in_work_frame, frame="fixture", work_frame=in_tracker),
        target_at("work frame on a base", in_work_frame, frame="fixture", work_frame=on_left),
    ]


def check_goals(goals: ArmGoals, position_M: Array, rotation_M: Array) -> None:
    np.testing.assert_allclose(goals.position_M, np.broadcast_to(position_M, goals.position_M.shape), atol=_AT_M)
    np.testing.assert_allclose(goals.rotation_M, np.broadcast_to(rotation_M, goals.rotation_M.shape), atol=_AT_M)


@given(poses, poses)
def test_one_physical_pose_is_one_goal_in_every_frame(T_M_S: Array, T_M_W: Array) -> None:
    targets = everywhere(T_M_S, T_M_W)
    goals = goals_of_arm(MODEL, targets, "left")
    assert goals.rows.tolist() == list(range(len(targets)))
    check_goals(goals, T_M_S[:3, 3], T_M_S[:3, :3])


@given(poses, poses)
def test_the_nominal_goal_is_that_of_the_nominal_base(T_M_S: Array, T_M_W: Array) -> None:
    goals = goals_of_arm(MODEL, everywhere(T_M_S, T_M_W), "left")
    expected = []
    for base in (None, "left", "left", "right", None, "left"):
        arm = None if base is None else MODEL.arms[base]
        shift = np.eye(4) if arm is None else arm.nominal.T_M_B() @ invert(arm.geometry.T_M_B())
        expected.append(shift @ T_M_S)
    np.testing.assert_allclose(goals.nominal_position_M, np.array(expected)[:, :3, 3], atol=_AT_M)
    np.testing.assert_allclose(goals.nominal_rotation_M, np.array(expected)[:, :3, :3], atol=_AT_M)


@given(poses, poses, poses)
def test_the_partner_is_seen_from_the_first_arm(T_M_S: Array, T_M_W: Array, T_S_P: Array) -> None:
    yaw, pitch, roll = zyx_angles(T_S_P[:3, :3])
    partner = Partner(arm="right", position=tuple(T_S_P[:3, 3].tolist()), rpy=(roll, pitch, yaw))
    targets = [target.model_copy(update={"partner": partner}) for target in everywhere(T_M_S, T_M_W)]
    check_goals(goals_of_arm(MODEL, targets, "left"), T_M_S[:3, 3], T_M_S[:3, :3])
    T_M_P = T_M_S @ T_S_P
    check_goals(goals_of_arm(MODEL, targets, "right"), T_M_P[:3, 3], T_M_P[:3, :3])


def test_free_rotations_are_nan_and_their_positions_are_not() -> None:
    free = Target(name="free", arm="left", position=(0.1, 0.2, 0.3), frame="tracker")
    partner = Partner(arm="right", position=(0.0, 0.0, 0.1))
    pair = Target(name="pair", arm="left", position=(1, 2, 3), rpy=(0, 0, 0), frame="tracker", partner=partner)
    left, right = (goals_of_arm(MODEL, [free, pair], name) for name in ("left", "right"))
    np.testing.assert_array_equal(np.isnan(left.rotation_M).any(axis=(1, 2)), [True, False])
    np.testing.assert_allclose(left.position_M, np.array([[0.1, 0.2, 0.3], [1, 2, 3]]))
    assert right.rows.tolist() == [1]
    assert np.isnan(right.rotation_M).all()
    np.testing.assert_allclose(right.position_M, np.array([[1.0, 2.0, 3.1]]))


def test_no_target_no_goal() -> None:
    goals = goals_of_arm(MODEL, [], "left")
    assert [len(getattr(goals, field.name)) for field in dataclasses.fields(goals)] == [0] * 5
    assert goals.rotation_M.shape == (0, 3, 3)


@given(poses, st.floats(-1e-3, 1e-3))
def test_a_work_frame_is_where_its_points_were_measured(T: Array, off: float) -> None:
    frame = work_frame(T, "tracker")
    T_parent_W, rms = work_frame_pose(frame)
    np.testing.assert_allclose(T_parent_W, T, atol=1e-11)
    assert rms < 1e-12
    first, *rest = frame.points
    x, y, z = first.measured
    touched = first.model_copy(update={"measured": (x, y, z + off)})
    _, rms = work_frame_pose(frame.model_copy(update={"points": (touched, *rest)}))
    assert rms <= abs(off) / 2.0 + 1e-12  # four points, and registration only makes the sum of squares smaller
