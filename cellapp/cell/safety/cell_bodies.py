"""Construction of the cell's bodies from its profile, with nominal or calibrated geometry."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.cell.safety.bodies import ArmBodies, TrackerField, place
from cellapp.cell.safety.gate import BEAM_RADIUS, CellBodies, clear_stops, visible
from cellapp.cell.safety.shapes import Cylinder, ObstacleBody, RoundedBox, Shape, load_mesh
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Arm, Profile
from cellapp.ground.profile.sections import (
    AnyObstacle,
    BoxObstacle,
    CapsuleObstacle,
    CylinderObstacle,
    MeshObstacle,
    SphereObstacle,
)
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array, apply, invert, transform
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
            raise InputError(
                f"profile {profile.name}: arms.{name}.base and tracker.pose are needed to move; 'cellapp docs cell'"
                " explains both"
            )
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


def require_arms(profile: Profile, model: CellModel) -> None:
    """Raise ``InputError`` unless a model is of the profile's arms, and each of these has a home position."""
    if set(model.arms) != set(profile.arms):
        known, asked = ", ".join(model.arms), ", ".join(profile.arms)
        raise InputError(f"the calibration is of arms {known}, the profile of arms {asked}; calibrate this run again")
    for name, arm in profile.arms.items():
        joints, identified = len(arm.type.joints), model.arms[name].geometry.joints
        if joints != identified:
            raise InputError(
                f"the calibration of arm {name} has {identified} joints, the profile {joints}; calibrate this run again"
            )
        if arm.home is None:
            raise InputError(f"profile {profile.name}: arms.{name}.home is needed: an arm waits there for the others")


def home_positions(profile: Profile) -> dict[str, np.ndarray]:
    """Return the joint positions before and after a job, arm -> (N,) [rad]; only of arms with a home position."""
    return {name: np.array(arm.home) for name, arm in profile.arms.items() if arm.home is not None}


def beside_homes(homes: Mapping[str, Array], q: Mapping[str, Array]) -> dict[str, Array]:
    """Return n stops of all arms, arm -> (n, N) [rad]: some arms at ``q``, the others at home."""
    n = len(next(iter(q.values())))
    return {name: q[name] if name in q else np.tile(home, (n, 1)) for name, home in homes.items()}


def clear_with_others(cell: CellBodies, homes: Mapping[str, Array], q: Mapping[str, Array]) -> np.ndarray:
    """Return whether the gate accepts each of n stops of some arms, the others at home, (n,) bool."""
    return clear_stops(cell, beside_homes(homes, q))


def visible_with_others(cell: CellBodies, homes: Mapping[str, Array], name: str, q: Mapping[str, Array]) -> np.ndarray:
    """Return whether the tracker sees the SMR of arm ``name`` at each of n stops of some arms, the others at home."""
    others = beside_homes(homes, q)
    return visible(cell, name, others.pop(name), others)


def _arm_bodies(arm: Arm, geometry: Geometry, mounted: Sequence[ObstacleBody]) -> ArmBodies:
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


def _obstacles(profile: Profile, bases: dict[str, Array]) -> tuple[list[ObstacleBody], dict[str, list[ObstacleBody]]]:
    """Return obstacles in the cell, poses in C; and arm -> those on its flange, poses in F. ``bases``: T_C_B."""
    placed: list[ObstacleBody] = []
    mounted: dict[str, list[ObstacleBody]] = {}
    for name, entry in profile.obstacles.items():
        pose = pose_matrix(entry.pose)
        shape, centre = shape_of(f"profile {profile.name}: obstacles.{name}", entry)
        obstacle = ObstacleBody(name, shape, pose @ transform(np.eye(3), centre))
        if entry.arm is None:
            placed.append(obstacle)
        elif entry.fixed_to == "base":
            placed.append(ObstacleBody(name, shape, bases[entry.arm] @ obstacle.pose, entry.arm))
        else:
            mounted.setdefault(entry.arm, []).append(obstacle)
    return placed, mounted


def shape_of(key: str, entry: AnyObstacle) -> tuple[Shape, Array]:
    """Return the solid of an obstacle, and the centre of the solid in the frame of the obstacle's pose, (3,) [m]."""
    match entry:
        case MeshObstacle():
            try:
                return load_mesh(entry.file, entry.scale)
            except InputError as error:
                raise InputError(f"{key}.file: {error}") from None
        case BoxObstacle():
            return RoundedBox(0.5 * np.array(entry.size)), np.zeros(3)
        case CylinderObstacle():
            return Cylinder(entry.radius, 0.5 * entry.length), np.zeros(3)
        case CapsuleObstacle():
            return RoundedBox(np.array([0.0, 0.0, 0.5 * entry.length]), entry.radius), np.zeros(3)
        case SphereObstacle():
            return RoundedBox(np.zeros(3), entry.radius), np.zeros(3)


# -- Distances of arms at rest from each obstacle: of their bases, and of all that moves ------------------------------


@dataclass(frozen=True)
class ObstacleClearance:
    """Distances of one arm from one obstacle of the cell.

    Attributes
    ----------
    obstacle, arm : str
    base : float
        Distance of the base bodies from it; zero or negative where they touch [m]. Infinite without base bodies.
    moving : float
        Least distance of the bodies that are checked against it [m]; infinite without any.
    asked : float
        The distance that these must keep [m].
    """

    obstacle: str
    arm: str
    base: float
    moving: float
    asked: float


def obstacle_clearances(cell: CellBodies, q: Mapping[str, Array]) -> Iterator[ObstacleClearance]:
    """Yield the distances of each arm of ``q`` (arm -> (N,) [rad]) from each obstacle of the cell."""
    for name, position in q.items():
        arm = cell.arms[name]
        bodies = place(arm, position[None])
        for obstacle, asked in zip(cell.obstacles, cell.obstacle_clearances[arm], strict=True):
            gaps = obstacle.gaps(bodies.start[0], bodies.end[0], bodies.radius, np.inf)
            checked = asked > -np.inf
            yield ObstacleClearance(
                obstacle.name,
                name,
                base=float(gaps[arm.frames == 0].min(initial=np.inf)),
                moving=float(gaps[checked].min(initial=np.inf)),
                asked=float(asked.max(initial=-np.inf)),
            )


# -- Capsules that cover a solid: what is mounted on a flange is checked as further bodies of its arm -----------------


_MOST_CAPSULES = 8
"""Largest number of capsules in a cover: as many as a six-joint arm has, so that checks take at most twice as long."""


@dataclass(frozen=True, eq=False)
class Cover:
    """Capsules that contain a solid; ``excess`` is the farthest that they reach beyond it [m].

    ``start``, ``end`` (c, 3) are in the frame in which the obstacle's pose is given [m], ``radius`` (c,) in [m]. The
    excess over a mesh is counted from its bounding box.
    """

    start: Array
    end: Array
    radius: Array
    excess: float


def cover(obstacle: ObstacleBody) -> Cover:
    """Cover an obstacle by capsules; exact for spheres and capsules."""
    shape = obstacle.shape
    if isinstance(shape, RoundedBox):
        found = _box_cover(shape.core, shape.radius)
    elif isinstance(shape, Cylinder):
        around_box = _box_cover(shape.half, 0.0)
        corner = (math.sqrt(2.0) - 1.0) * shape.radius
        found = min(
            _cylinder_cover(shape),
            Cover(around_box.start, around_box.end, around_box.radius, around_box.excess + corner),
            key=lambda one: one.excess,
        )
    else:
        found = _box_cover(shape.half, 0.0)
    return Cover(apply(obstacle.pose, found.start), apply(obstacle.pose, found.end), found.radius, found.excess)


def _cylinder_cover(shape: Cylinder) -> Cover:
    """Cover by one capsule through both rims, shortened until its excess at the ends equals that at the side."""
    inset = min(shape.radius, shape.half_length)
    radius = math.hypot(shape.radius, inset)
    end = np.array([[0.0, 0.0, shape.half_length - inset]])
    return Cover(-end, end, np.array([radius]), radius - inset)


def _box_cover(core: Array, rounding: float) -> Cover:
    """Cover by capsules along the longest side of a box, each containing one tile of a grid over the other two sides.

    A capsule around a tile with half sides p, q passes through its corners; it is shortened by min(p, q), so that its
    excess at the ends equals that at the larger faces. Of all grids the one with the smallest excess is taken.
    """
    along = int(np.argmax(core))
    first, second = (axis for axis in range(3) if axis != along)

    def excess(rows: int, columns: int) -> float:
        p, q = float(core[first]) / rows, float(core[second]) / columns
        return math.hypot(p, q, min(p, q)) - min(p, q)

    counts = range(1, _MOST_CAPSULES + 1)
    grids = [(rows, columns) for rows in counts for columns in counts if rows * columns <= _MOST_CAPSULES]
    rows, columns = min(grids, key=lambda grid: round(excess(*grid), 9))
    p, q = core[first] / rows, core[second] / columns
    centres = np.zeros((rows * columns, 3))
    u, v = np.meshgrid((2 * np.arange(rows) + 1 - rows) * p, (2 * np.arange(columns) + 1 - columns) * q)
    centres[:, first], centres[:, second] = u.ravel(), v.ravel()
    axis = np.zeros(3)
    axis[along] = core[along] - min(p, q)
    radius = np.full(len(centres), math.hypot(p, q, min(p, q)) + rounding)
    return Cover(centres - axis, centres + axis, radius, excess(rows, columns))
