"""Compute the goals of the SMRs in the tracker frame for targets given in any frame of the cell.

Complete the profile of a cell in which nothing moves, so that commands can be computed from its readings alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.cell.targets.targets import Target, WorkFrame
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Arm, Pose, Profile
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array, apply, register, rms_length
from cellapp.robot.model import CellModel

_FREE = (np.nan, np.nan, np.nan)
"""Roll, pitch, yaw of a free rotation."""


@dataclass(frozen=True, eq=False)
class ArmGoals:
    """Goals of one arm.

    Attributes
    ----------
    rows : array, shape (m,)
        Index of each goal's target in the list.
    position_M, nominal_position_M : array, shape (m, 3)
        SMR centre [m] from the calibrated and from the nominal bases, the same for targets in the tracker frame.
    rotation_M, nominal_rotation_M : array, shape (m, 3, 3)
        Flange rotation; NaN if it is free.
    """

    rows: NDArray[np.intp]
    position_M: Array
    rotation_M: Array
    nominal_position_M: Array
    nominal_rotation_M: Array


def goals_of_arm(model: CellModel, targets: Sequence[Target], name: str) -> ArmGoals:
    """Return the goals of arm ``name`` among all targets, as their arm or as the partner of a cooperative one."""
    rows = [k for k, target in enumerate(targets) if name in target.arms]
    own = [targets[k] for k in rows]
    rotation, position = _in_frames(own, name)
    frame, parents, T_parent_W = _frames(own)
    T_calibrated, T_nominal = (
        _frame_poses(chains, parents, T_parent_W)[frame]
        for chains in (
            {name: arm.geometry for name, arm in model.arms.items()},
            {name: arm.nominal for name, arm in model.arms.items()},
        )
    )
    return ArmGoals(
        rows=np.array(rows, dtype=np.intp),
        position_M=_moved(T_calibrated, position),
        rotation_M=T_calibrated[:, :3, :3] @ rotation,
        nominal_position_M=_moved(T_nominal, position),
        nominal_rotation_M=T_nominal[:, :3, :3] @ rotation,
    )


def work_frame_pose(frame: WorkFrame) -> tuple[Array, float]:
    """Return the pose (4, 4) of a work frame in its parent, and the rms residual [m] of its points."""
    nominal = np.array([point.nominal for point in frame.points])
    measured = np.array([point.measured for point in frame.points])
    T = register(measured, nominal)
    residual = measured - apply(T, nominal)
    return T, rms_length(residual)


# -- inside -----------------------------------------------------------------------------------------------------------


def _in_frames(targets: Sequence[Target], name: str) -> tuple[Array, Array]:
    """Return rotations (m, 3, 3), NaN if free, and SMR positions (m, 3) [m] of one arm in the targets' frames."""
    rotation = _rotations([target.rpy for target in targets])
    position = np.array([target.position for target in targets]).reshape(-1, 3)
    partners = [(k, target.partner) for k, target in enumerate(targets) if target.partner and target.arm != name]
    if partners:
        at = [k for k, _ in partners]
        place = np.array([partner.position for _, partner in partners])
        position[at] += np.einsum("nij,nj->ni", rotation[at], place)
        rotation[at] = rotation[at] @ _rotations([partner.rpy for _, partner in partners])
    return rotation, position


def _rotations(rpy: Sequence[tuple[float, float, float] | None]) -> Array:
    """Return rotations (m, 3, 3) from roll, pitch, yaw [rad]; NaN for None."""
    angles = np.array([_FREE if value is None else value for value in rpy]).reshape(-1, 3)
    given = ~np.isnan(angles[:, 0])
    rotation = np.full((len(angles), 3, 3), np.nan)
    if np.any(given):  # some versions of scipy refuse an empty batch
        rotation[given] = scipy.spatial.transform.Rotation.from_euler("ZYX", angles[given][:, ::-1]).as_matrix()
    return rotation


def _frames(targets: Sequence[Target]) -> tuple[NDArray[np.intp], list[str], Array]:
    """Return each target's index of its frame, and for each frame its parent and its pose (f, 4, 4) in the parent.

    The targets of a list share their work frame objects; each is registered once.
    """
    found: dict[str | int, int] = {}
    parents: list[str] = []
    poses: list[Array] = []
    index = np.empty(len(targets), dtype=np.intp)
    for k, target in enumerate(targets):
        frame = target.work_frame
        parent = target.arm if target.frame == "base" else target.frame
        key = parent if frame is None else id(frame)
        if key not in found:
            found[key] = len(parents)
            parents.append(parent if frame is None else frame.parent)
            poses.append(np.eye(4) if frame is None else work_frame_pose(frame)[0])
        index[k] = found[key]
    return index, parents, np.array(poses).reshape(-1, 4, 4)


def _frame_poses(chains: Mapping[str, Geometry], parents: Sequence[str], T_parent_W: Array) -> Array:
    """Return the poses (f, 4, 4) of frames in the tracker frame."""
    T_M_parent = [np.eye(4) if parent == "tracker" else chains[parent].T_M_B() for parent in parents]
    return np.array(T_M_parent).reshape(-1, 4, 4) @ T_parent_W


def _moved(T: Array, position: Array) -> Array:
    """Transform positions (m, 3) [m], each with its own pose (m, 4, 4)."""
    return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], position) + T[:, :3, 3])


UNPLACED = (
    "the profile does not say where arms and tracker stand: limits of the joints and the arms' own bodies were"
    " checked, floor, obstacles and the tracker's view were not; of several solutions the one nearest to the measured"
    " configurations is taken"
)
"""Note that must accompany commands for such a cell."""
_ORIGIN = Pose(position=(0.0, 0.0, 0.0))


def is_unplaced(profile: Profile) -> bool:
    """Return whether nothing can be driven, and something that only motion needs is not stated."""
    arms = profile.arms.values()
    if any(arm.driver.has_device for arm in arms):
        return False
    return profile.tracker.pose is None or any(arm.base is None or arm.home is None for arm in arms)


def commanded_profile(profile: Profile, readings: Mapping[str, Readings]) -> Profile:
    """Return the profile for computing commands: that of the readings, completed if it ``is_unplaced``.

    Then the tracker's frame is the cell's, there is no floor, and each arm's home is a measured configuration. The
    poses of the bases come from the calibrated model.
    """
    if not is_unplaced(profile):
        return profile
    arms = {name: _completed(arm, readings.get(name)) for name, arm in profile.arms.items()}
    plan = profile.plan.model_copy(update={"floor": -math.inf, "ceiling": None})
    tracker = profile.tracker.model_copy(update={"pose": _ORIGIN})
    return profile.model_copy(update={"arms": arms, "plan": plan, "tracker": tracker, "obstacles": {}})


# -- inside -----------------------------------------------------------------------------------------------------------


def _completed(arm: Arm, readings: Readings | None) -> Arm:
    home = arm.home if arm.home is not None or readings is None else _usual(readings)
    smr = arm.smr.model_copy(update={"acceptance": math.pi})  # visibility does not matter here
    return arm.model_copy(update={"base": _ORIGIN, "home": home, "smr": smr})


def _usual(readings: Readings) -> tuple[float, ...]:
    """Return the measured configuration nearest to the median of all [rad]."""
    away = np.abs(readings.q - np.median(readings.q, axis=0)).max(axis=1)
    return tuple(readings.q[int(np.argmin(away))].tolist())
