"""Where the SMRs of the arms have to be in the tracker frame for targets given in any frame of the cell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.compensation.targets import Target, WorkFrame
from cellapp.kinematics.chain import Geometry
from cellapp.kinematics.transforms import Array, register, rotation_zyx
from cellapp.model import ArmModel, CellModel


@dataclass(frozen=True, eq=False)
class ArmGoals:
    """The goals of one arm.

    Attributes
    ----------
    rows : array, shape (m,)
        The target of each goal, as index into the list.
    position_M, nominal_position_M : array, shape (m, 3)
        SMR centre [m] by the calibrated and by the nominal bases. Both are the same for targets in the tracker frame.
    rotation_M, nominal_rotation_M : array, shape (m, 3, 3)
        Flange rotation; NaN where it is free.
    """

    rows: NDArray[np.intp]
    position_M: Array
    rotation_M: Array
    nominal_position_M: Array
    nominal_rotation_M: Array


def goals_of_arm(model: CellModel, targets: Sequence[Target], name: str) -> ArmGoals:
    """The goals of arm ``name`` among all targets: as their arm, or as the partner of a cooperative one."""
    rows = [k for k, target in enumerate(targets) if name in target.arms]
    calibrated = [_goal(model, _calibrated, targets[k], name) for k in rows]
    nominal = [_goal(model, _nominal, targets[k], name) for k in rows]
    T_M_S, T_nominal = (np.array(poses).reshape(-1, 4, 4) for poses in (calibrated, nominal))
    return ArmGoals(
        rows=np.array(rows, dtype=np.intp),
        position_M=T_M_S[:, :3, 3],
        rotation_M=T_M_S[:, :3, :3],
        nominal_position_M=T_nominal[:, :3, 3],
        nominal_rotation_M=T_nominal[:, :3, :3],
    )


def work_frame_pose(frame: WorkFrame) -> tuple[Array, float]:
    """Pose (4, 4) of a work frame in its parent, and the rms distance [m] of its points after registration."""
    nominal = np.array([point.nominal for point in frame.points])
    measured = np.array([point.measured for point in frame.points])
    T = register(measured, nominal)
    left = measured - (nominal @ T[:3, :3].T + T[:3, 3])
    return T, float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


# -- inside -----------------------------------------------------------------------------------------------------------


def _calibrated(arm: ArmModel) -> Geometry:
    return arm.geometry


def _nominal(arm: ArmModel) -> Geometry:
    return arm.nominal


def _goal(model: CellModel, chain: Callable[[ArmModel], Geometry], target: Target, name: str) -> Array:
    """SMR pose (4, 4) of one arm in the tracker frame; the rotation is NaN where it is free."""
    T = _frame(model, chain, target) @ _pose(target.position, target.rpy)
    if name == target.arm or target.partner is None:
        return np.asarray(T)
    return np.asarray(T @ _pose(target.partner.position, target.partner.rpy))


def _frame(model: CellModel, chain: Callable[[ArmModel], Geometry], target: Target) -> Array:
    """Pose (4, 4) of a target's frame in the tracker frame."""
    if target.work_frame is not None:
        T_parent_W, _ = work_frame_pose(target.work_frame)
        return np.asarray(_parent(model, chain, target.work_frame.parent) @ T_parent_W)
    return _parent(model, chain, target.arm if target.frame == "base" else target.frame)


def _parent(model: CellModel, chain: Callable[[ArmModel], Geometry], parent: str) -> Array:
    return np.eye(4) if parent == "tracker" else chain(model.arms[parent]).T_M_B()


def _pose(position: tuple[float, float, float], rpy: tuple[float, float, float] | None) -> Array:
    T = np.eye(4)
    T[:3, 3] = position
    T[:3, :3] = np.nan if rpy is None else rotation_zyx(rpy[2], rpy[1], rpy[0])
    return T
