"""Pose of a base in the cell, from points that the tracker measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellapp.cell.profile.draft import SURVEYED, ProfileDraft, with_text
from cellapp.cell.profile.draft_check import arm_and_tracker_pose
from cellapp.cell.profile.survey_points import SurveyPoint
from cellapp.estimation.calibration.base_from_points import BaseFit, base_from_points
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Arm, Pose
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array, rpy_of
from cellapp.robot.model.nominal import nominal_arm, pose_matrix


@dataclass(frozen=True)
class SurveyedBase:
    """A base pose in the cell frame, and the fit it comes from."""

    pose: Pose
    fit: BaseFit


def surveyed_base(arm: Arm, points: Sequence[SurveyPoint], tracker: Pose) -> SurveyedBase:
    """Compute the pose of an arm's base in C from points in the tracker frame and the tracker's pose in C.

    Points given by joint positions use the arm's nominal geometry and its SMR offset.

    Raises
    ------
    InputError
        If a point cannot be used, or the points do not determine the base.
    """
    p_B = np.array([_point_at_base(arm, number, point) for number, point in enumerate(points, start=1)])
    p_M = np.array([point.tracker for point in points])
    fit = base_from_points(p_B.reshape(-1, 3), p_M.reshape(-1, 3))
    T_C_B = pose_matrix(tracker) @ fit.T_M_B
    x, y, z = T_C_B[:3, 3].tolist()
    return SurveyedBase(Pose(position=(x, y, z), rpy=rpy_of(T_C_B[:3, :3])), fit)


def draft_with_surveyed_base(
    draft: ProfileDraft, index: int, points: Sequence[SurveyPoint], path: Path
) -> tuple[ProfileDraft, SurveyedBase]:
    """Return the draft with the base of one arm computed from points; ``path`` is the profile's (future) path.

    Raises
    ------
    InputError
        As ``surveyed_base``, and if the arm or the tracker's pose is not valid yet.
    """
    arm, tracker = arm_and_tracker_pose(draft, index, path)
    found = surveyed_base(arm, points, tracker)
    position = ", ".join(f"{value:z.4f}" for value in found.pose.position)
    rpy = ", ".join(f"{value:z.3f} deg" for value in np.degrees(found.pose.rpy))
    draft = with_text(with_text(draft, f"arms.{index}.position", position), f"arms.{index}.rpy", rpy)
    return with_text(draft, f"arms.{index}.note", f"{SURVEYED} {found.fit.sentence}."), found


def _point_at_base(arm: Arm, number: int, point: SurveyPoint) -> Array:
    """Return the point in the base frame, (3,) [m]."""
    if point.joints is None:
        return np.array(point.base)
    if len(point.joints) != len(arm.type.joints):
        raise InputError(
            f"point {number}: {len(point.joints)} joint positions for the {len(arm.type.joints)} joints of"
            f" {arm.type.model}"
        )
    if arm.smr.offset == "unknown":
        raise InputError(
            f"point {number}: joint positions need the SMR offset; give it, or coordinates in the base frame"
        )
    position: Array = smr_positions(nominal_arm(arm), np.array([point.joints]))[0]
    return position
