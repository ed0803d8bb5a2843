"""Construction of the cell's bodies from its profile, with nominal or calibrated geometry."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cellapp.cell.safety.bodies import ArmBodies
from cellapp.cell.safety.covers import cover
from cellapp.cell.safety.gate import BEAM_RADIUS, CellBodies
from cellapp.cell.safety.mesh_files import load_mesh
from cellapp.cell.safety.obstacle_clearance import obstacle_clearances
from cellapp.cell.safety.obstacles import Obstacle
from cellapp.cell.safety.shapes import Cylinder, RoundedBox, Shape
from cellapp.cell.safety.visibility import TrackerField
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Arm, Profile
from cellapp.ground.profile.obstacles import (
    AnyObstacle,
    BoxObstacle,
    CapsuleObstacle,
    CylinderObstacle,
    MeshObstacle,
    SphereObstacle,
)
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array, invert, transform
from cellapp.robot.model import CellModel
from cellapp.robot.model.nominal import nominal_arm, pose_matrix


def cell_bodies(profile: Profile, model: CellModel | None = None) -> CellBodies:
    """Build the bodies of the profile's cell. With a model, bases and chains of the arms are the identified ones, and
    the tracker stands where the model says.

    Obstacles that are fixed to a base stand where that base is found.

    Raises
    ------
    InputError
        If the profile lacks the pose of an arm's base or of the tracker, the mesh of an obstacle cannot be used, or an
        obstacle contains the tracker's head or a part of an arm at home.
    """
    tracker = profile.tracker
    T_C_M = None if tracker.pose is None else pose_matrix(tracker.pose)
    if T_C_M is not None and model is not None and model.T_M_M0 is not None:
        T_C_M = T_C_M @ invert(model.T_M_M0)
    geometries = {}
    for name, arm in profile.arms.items():
        if arm.base is None or T_C_M is None:
            raise InputError(f"profile {profile.name}: arms.{name}.base and tracker.pose are needed to move")
        if model is None:
            geometries[name] = nominal_arm(arm).with_T_M_B(pose_matrix(arm.base))
        else:
            identified = model.arms[name].geometry
            geometries[name] = identified.with_T_M_B(T_C_M @ identified.T_M_B())
    placed, mounted = _obstacles(profile, {name: geometry.T_M_B() for name, geometry in geometries.items()})
    arms = {name: _arm_bodies(arm, geometries[name], mounted.get(name, [])) for name, arm in profile.arms.items()}
    field = None
    if T_C_M is not None:
        field = TrackerField(T_C_M, tracker.azimuth, tracker.elevation, tracker.distance)
    ceiling = math.inf if profile.plan.ceiling is None else profile.plan.ceiling
    cell = CellBodies(arms, field, profile.plan.clearance, profile.plan.floor, ceiling, tuple(placed))
    _check_obstacles(profile, cell)
    return cell


def home_positions(profile: Profile) -> dict[str, np.ndarray]:
    """Return the joint positions before and after a job, arm -> (N,) [rad]; only of arms with a home position."""
    return {name: np.array(arm.home) for name, arm in profile.arms.items() if arm.home is not None}


def _arm_bodies(arm: Arm, geometry: Geometry, mounted: Sequence[Obstacle]) -> ArmBodies:
    """Build the capsules of an arm's type, then those that cover what is mounted on its flange."""
    capsules, covers = arm.type.capsules, [cover(obstacle) for obstacle in mounted]
    covered = [obstacle.name for obstacle, one in zip(mounted, covers, strict=True) for _ in one.radius]
    frames = [capsule.frame for capsule in capsules] + [geometry.joints] * len(covered)
    start = np.array([capsule.start for capsule in capsules]).reshape(-1, 3)
    end = np.array([capsule.end for capsule in capsules]).reshape(-1, 3)
    radius = np.array([capsule.radius for capsule in capsules])
    return ArmBodies(
        geometry=geometry,
        frames=np.array(frames, dtype=np.int64),
        start=np.concatenate([start, *(one.start for one in covers)]),
        end=np.concatenate([end, *(one.end for one in covers)]),
        radius=np.concatenate([radius, *(one.radius for one in covers)]),
        limits=np.array(arm.joint_limits),
        normal_F=np.array(arm.smr.normal) / math.hypot(*arm.smr.normal),
        acceptance=arm.smr.acceptance,
        mounted=tuple(mounted),
        covered=tuple(covered),
    )


def _check_obstacles(profile: Profile, cell: CellBodies) -> None:
    """Refuse obstacles that contain the tracker's head or a part of an arm at home: their pose or size is wrong."""
    if cell.field is not None:
        head = cell.field.T_C_M[None, :3, 3]
        for obstacle in cell.obstacles:
            if not obstacle.gaps(head, head, 0.0, np.inf)[0] > BEAM_RADIUS:
                raise InputError(
                    f"profile {profile.name}: obstacles.{obstacle.name}.pose: the tracker's head, tracker.pose, is"
                    " inside it or touches it, so that every beam would end there; correct one of them"
                )
    homes = {name: q for name, q in home_positions(profile).items() if q.shape == (cell.arms[name].geometry.joints,)}
    for one in obstacle_clearances(cell, homes):
        if one.moving < 0.0:
            raise InputError(
                f"profile {profile.name}: obstacles.{one.obstacle}.pose: arm {one.arm} at home reaches"
                f" {-1e3 * one.moving:.0f} mm into it; correct its pose or size, arms.{one.arm}.home or .base"
            )


def _obstacles(profile: Profile, bases: dict[str, Array]) -> tuple[list[Obstacle], dict[str, list[Obstacle]]]:
    """Return obstacles in the cell, poses in C; and arm -> those on its flange, poses in F. ``bases``: T_C_B."""
    placed: list[Obstacle] = []
    mounted: dict[str, list[Obstacle]] = {}
    for name, entry in profile.obstacles.items():
        pose = pose_matrix(entry.pose)
        shape, centre = _shape(f"profile {profile.name}: obstacles.{name}", entry)
        obstacle = Obstacle(name, shape, pose @ transform(np.eye(3), centre))
        if entry.arm is None:
            placed.append(obstacle)
        elif entry.fixed_to == "base":
            placed.append(Obstacle(name, shape, bases[entry.arm] @ obstacle.pose, entry.arm))
        else:
            mounted.setdefault(entry.arm, []).append(obstacle)
    return placed, mounted


def _shape(key: str, entry: AnyObstacle) -> tuple[Shape, Array]:
    """Return the solid of an obstacle, and the centre of the solid in the frame of the obstacle's pose, (3,) [m]."""
    if isinstance(entry, MeshObstacle):
        try:
            return load_mesh(entry.file, entry.scale)
        except InputError as error:
            raise InputError(f"{key}.file: {error}") from None
    return _primitive(entry), np.zeros(3)


def _primitive(entry: BoxObstacle | CylinderObstacle | CapsuleObstacle | SphereObstacle) -> Shape:
    match entry:
        case BoxObstacle():
            return RoundedBox(0.5 * np.array(entry.size))
        case CylinderObstacle():
            return Cylinder(entry.radius, 0.5 * entry.length)
        case CapsuleObstacle():
            return RoundedBox(np.array([0.0, 0.0, 0.5 * entry.length]), entry.radius)
        case SphereObstacle():
            return RoundedBox(np.zeros(3), entry.radius)
