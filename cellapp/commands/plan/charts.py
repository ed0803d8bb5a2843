"""Charts of a plan before it is measured: expected errors, joint ranges, time, correlations.

Obstacles in maps of the cell: outlines from above and from the tracker, and the directions that they block.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellapp.cell.safety.shapes import load_mesh
from cellapp.commands.plan.result import PlannedStop
from cellapp.commands.view.charts import Axis, Chart, Series, enumerated, series
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Pose, Profile
from cellapp.ground.profile.sections import (
    AnyObstacle,
    BoxObstacle,
    CapsuleObstacle,
    CylinderObstacle,
    MeshObstacle,
    SphereObstacle,
)
from cellapp.robot.kinematics.chain import flange_poses, smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, invert
from cellapp.robot.model.nominal import nominal_arm, pose_matrix

View = Literal["above", "tracker"]

OBSTACLE_STYLE = 5
"""Style of obstacles; the arms of a cell of two have other styles."""
_AROUND = 24
"""Points around a circle: a chord is at most 1 % of the radius off."""
_ALONG = 5
"""Points along an edge: straight edges look curved in azimuth and elevation."""


@dataclass(frozen=True, eq=False)
class Outlined:
    """An obstacle with points (n, 3) of its surface in the cell frame C [m]; it is drawn as their hull."""

    name: str
    p_C: Array


def outlined_obstacles(profile: Profile) -> list[Outlined]:
    """Return the obstacles whose arm has a pose, those on a flange with it at home; a mesh as its convex hull."""
    bases = {name: pose_matrix(arm.base) for name, arm in profile.arms.items() if arm.base is not None}
    flanges = {}
    for name, T_C_B in bases.items():
        arm = profile.arms[name]
        if arm.home is not None:
            rotation, origin = flange_poses(nominal_arm(arm).with_T_M_B(T_C_B), np.array([arm.home]))
            flanges[name] = np.block([[rotation[0], origin[0][:, None]], [np.zeros(3), 1.0]])
    found = []
    for name, one in profile.obstacles.items():
        frame = np.eye(4) if one.arm is None else (bases if one.fixed_to == "base" else flanges).get(one.arm)
        points = surface_points(one)
        if frame is not None and len(points):
            T_C_O = frame @ pose_matrix(Pose(position=one.pose.position, rpy=one.pose.rpy))
            found.append(Outlined(name, apply(T_C_O, points)))
    return found


def surface_points(obstacle: AnyObstacle) -> Array:
    """Return points (n, 3) [m] in the obstacle's frame that span its convex hull; none if a mesh cannot be read."""
    match obstacle:
        case BoxObstacle():
            edges = (np.linspace(-0.5 * length, 0.5 * length, _ALONG) for length in obstacle.size)
            return np.stack(np.meshgrid(*edges), axis=-1).reshape(-1, 3)
        case CylinderObstacle():
            return _along_z(_circle(obstacle.radius), np.linspace(-0.5, 0.5, _ALONG) * obstacle.length)
        case CapsuleObstacle():
            return _along_z(_sphere(obstacle.radius), np.array([-0.5, 0.5]) * obstacle.length)
        case SphereObstacle():
            return _sphere(obstacle.radius)
        case MeshObstacle():
            try:
                mesh, centre = load_mesh(obstacle.file, obstacle.scale)
            except InputError:  # draw the map without it; planning reports the error
                return np.empty((0, 3))
            return mesh.vertices + centre


def _circle(radius: float) -> Array:
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(_AROUND)])


def _sphere(radius: float) -> Array:
    """Return the points of circles of latitude of a sphere."""
    up = np.pi * (np.arange(_AROUND // 2 + 1) / (_AROUND // 2) - 0.5)
    circles = _circle(radius)[None] * np.cos(up)[:, None, None]
    circles[:, :, 2] = radius * np.sin(up)[:, None]
    return circles.reshape(-1, 3)


def _along_z(points: Array, at: Array) -> Array:
    """Return copies of points (n, 3), shifted along z to each height of ``at`` (m,)."""
    return np.asarray((points[None] + at[:, None, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3))


def obstacle_series(obstacles: Iterable[Outlined], T_C_M: Array | None, view: View) -> Iterator[Series]:
    """Yield the outlines of all obstacles as one series with gaps; the view of the tracker needs ``T_C_M``."""
    gap = np.full((1, 2), np.nan)
    lines = [part for one in obstacles for part in (outline(seen_from(one.p_C, T_C_M, view)), gap)]
    if lines:
        x, y = np.concatenate(lines).T
        yield series("obstacles", x, y, style=OBSTACLE_STYLE)


def seen_from(p_C: Array, T_C_M: Array | None, view: View) -> Array:
    """Project points (n, 3): x and y [m] from above, or azimuth and elevation [deg] from the tracker; shape (n, 2).

    Azimuths continue from that of the points' centre, so that a body behind the tracker stays in one piece.
    """
    if view == "above" or T_C_M is None:
        return p_C[:, :2]
    p_M = apply(invert(T_C_M), p_C)
    x, y, z = p_M.T
    middle = np.arctan2(*p_M.mean(axis=0)[1::-1])
    azimuth = middle + np.mod(np.arctan2(y, x) - middle + np.pi, 2.0 * np.pi) - np.pi
    return np.asarray(np.degrees(np.column_stack([azimuth, np.arctan2(z, np.hypot(x, y))])))


def outline(points: Array) -> Array:
    """Return the convex hull of points (n, 2) as a closed line (k, 2)."""
    from scipy.spatial import ConvexHull

    vertices = ConvexHull(points, qhull_options="QJ").vertices  # QJ joggles the points: a flat mesh has a hull, too
    return np.asarray(points[[*vertices, vertices[0]]])


# -- Maps of the cell: bases, tracker, stops and obstacles from above, and as the tracker sees them -------------------


_PLANNED, _MEASURED = "○△□◇", "●▲■◆"
"""Marks of the arms: hollow for planned stops, full for measured ones."""
_AXES: Mapping[View, tuple[Axis, Axis]] = {
    "above": (Axis("x", "m"), Axis("y", "m")),
    "tracker": (Axis("azimuth", "deg"), Axis("elevation", "deg")),
}
_TITLES: Mapping[View, str] = {"above": "The cell from above", "tracker": "The cell as the tracker sees it"}
_OTHER_STYLE = 4
"""Style of series that belong to no arm."""


@dataclass(frozen=True, eq=False)
class _Marks:
    """Positions (n, 3) in the cell frame C [m] drawn with the same mark."""

    name: str
    p_C: Array
    mark: str
    style: int

    def series(self, T_C_M: Array, view: View) -> Series:
        x, y = seen_from(self.p_C, T_C_M, view).T
        return series(self.name, x, y, "points", style=self.style, mark=self.mark)


def cell_map_chart(profile: Profile, stops: Sequence[PlannedStop], view: View = "above") -> Chart:
    """Show bases, tracker, obstacles, and the SMR at planned and measured stops, with the nominal geometry.

    From above in the cell frame C [m], or as azimuth and elevation [deg] in the tracker frame M.
    """
    pose = profile.tracker.pose
    bases = {name: pose_matrix(arm.base) for name, arm in profile.arms.items() if arm.base is not None}
    if pose is None or not bases:
        message = "No map: the profile does not say where bases and tracker are (arms.*.base, tracker.pose)."
        return Chart(_TITLES[view], *_AXES[view], (), message)
    T_C_M = pose_matrix(pose)
    smr = {name: _smr_positions(profile, name, T_C_B, stops) for name, T_C_B in bases.items()}
    things = [*_stop_marks(smr, stops)]
    things.append(_Marks("base", np.array([T_C_B[:3, 3] for T_C_B in bases.values()]), "B", _OTHER_STYLE))
    if view == "above":
        things.append(_Marks("tracker", T_C_M[:3, 3][np.newaxis], "T", _OTHER_STYLE))
    points = [thing.series(T_C_M, view) for thing in things if len(thing.p_C)]
    lines = obstacle_series(outlined_obstacles(profile), T_C_M, view)
    message = _message(smr, stops, T_C_M)
    return Chart(_TITLES[view], *_AXES[view], (*lines, *points), message, equal=view == "above")


def _smr_positions(profile: Profile, name: str, T_C_B: Array, stops: Sequence[PlannedStop]) -> Array:
    """Compute the nominal SMR positions (n, 3) of one arm in C [m] at all stops."""
    geometry = nominal_arm(profile.arms[name]).with_T_M_B(T_C_B)
    return smr_positions(geometry, np.array([stop.q[name] for stop in stops]).reshape(-1, geometry.joints))


def _stop_marks(smr: Mapping[str, Array], stops: Sequence[PlannedStop]) -> Iterator[_Marks]:
    measured = np.array([stop.measured for stop in stops], dtype=np.bool_)
    for style, (name, p_C) in enumerate(smr.items()):
        shape = style % len(_PLANNED)
        yield _Marks(f"{name} planned", p_C[~measured], _PLANNED[shape], style)
        yield _Marks(f"{name} measured", p_C[measured], _MEASURED[shape], style)


def _message(smr: Mapping[str, Array], stops: Sequence[PlannedStop], T_C_M: Array) -> str:
    """Say how many stops are measured, and how far they are from the tracker."""
    if not stops:
        return f"Bases of {enumerated(smr)} and the tracker; no stops yet: plan first."
    away = np.linalg.norm(np.concatenate(list(smr.values())) - T_C_M[:3, 3], axis=1)
    measured = sum(stop.measured for stop in stops)
    return (
        f"{measured} of {counted(len(stops), 'planned stop is', 'planned stops are')} measured; they are"
        f" {away.min():.1f} to {away.max():.1f} m from"
        " the tracker."
    )
