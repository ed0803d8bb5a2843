"""The map of a cell from above: bases, tracker, planned and measured stops, outlines of obstacles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from cellapp.cell.safety.cell_bodies import shape_of
from cellapp.cell.safety.shapes import Cylinder, Mesh, RoundedBox
from cellapp.commands.plan.result import PlannedStop
from cellapp.commands.view.charts import Axis, Chart, Series, enumerated, series
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import AnyObstacle
from cellapp.robot.kinematics.chain import flange_poses, smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, transform
from cellapp.robot.model.nominal import nominal_arm, pose_matrix

OBSTACLE_STYLE = 5
"""Style of obstacles; the arms of a cell of two have other styles."""
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
"""Around a circle: a chord is at most 1 % of the radius off."""
_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros_like(_ANGLES)])
_SPHERE = np.concatenate([_CIRCLE * np.cos(up) + (0.0, 0.0, np.sin(up)) for up in np.linspace(-0.5, 0.5, 13) * np.pi])
"""Points of circles of latitude."""
_CORNERS = np.array([*product((-1.0, 1.0), repeat=3)])
"""Of a box with sides of two about the origin."""


def outlined_obstacles(profile: Profile) -> dict[str, Array]:
    """Return points (n, 3) of the surface of each obstacle in the cell frame C [m]; it is drawn as their hull.

    Only obstacles whose arm has a pose, those on a flange with it at home.
    """
    bases = {name: pose_matrix(arm.base) for name, arm in profile.arms.items() if arm.base is not None}
    flanges = {}
    for name, T_C_B in bases.items():
        arm = profile.arms[name]
        if arm.home is not None:
            rotation, origin = flange_poses(nominal_arm(arm).with_T_M_B(T_C_B), np.array([arm.home]))
            flanges[name] = transform(rotation[0], origin[0])
    found = {}
    for name, one in profile.obstacles.items():
        frame = np.eye(4) if one.arm is None else (bases if one.fixed_to == "base" else flanges).get(one.arm)
        points = surface_points(name, one)
        if frame is not None and len(points):
            found[name] = apply(frame @ pose_matrix(one.pose), points)
    return found


def surface_points(name: str, obstacle: AnyObstacle) -> Array:
    """Return points (n, 3) [m] in the obstacle's frame that span its convex hull; none if a mesh cannot be read."""
    try:
        shape, centre = shape_of(name, obstacle)
    except InputError:  # draw the map without it; planning reports the error
        return np.empty((0, 3))
    if isinstance(shape, Mesh):
        return shape.vertices + centre
    if isinstance(shape, Cylinder):
        middle, around = _CORNERS * (0.0, 0.0, shape.half_length), _CIRCLE
    else:
        assert isinstance(shape, RoundedBox)
        middle, around = _CORNERS * shape.core, _SPHERE
    return np.asarray(middle[:, None] + shape.radius * around).reshape(-1, 3)


def obstacle_series(obstacles: Iterable[Array]) -> Iterator[Series]:
    """Yield the outlines of all obstacles from above as one series with gaps."""
    gap = np.full((1, 2), np.nan)
    lines = [part for p_C in obstacles for part in (outline(p_C[:, :2]), gap)]
    if lines:
        x, y = np.concatenate(lines).T
        yield series("obstacles", x, y, style=OBSTACLE_STYLE)


def outline(points: Array) -> Array:
    """Return the convex hull of points (n, 2) as a closed line (k, 2)."""
    from scipy.spatial import ConvexHull

    vertices = ConvexHull(points, qhull_options="QJ").vertices  # QJ joggles the points: a flat mesh has a hull, too
    return np.asarray(points[[*vertices, vertices[0]]])


# -- Map of the cell: bases, tracker, stops and obstacles from above --------------------------------------------------


_PLANNED, _MEASURED = "○△□◇", "●▲■◆"
"""Marks of the arms: hollow for planned stops, full for measured ones."""
_TITLE, _AXES = "The cell from above", (Axis("x", "m"), Axis("y", "m"))
_OTHER_STYLE = 4
"""Style of series that belong to no arm."""


def _points(name: str, p_C: Array, mark: str, style: int) -> Series:
    """Return positions (n, 3) in C [m] that are drawn with the same mark."""
    return series(name, p_C[:, 0], p_C[:, 1], "points", style=style, mark=mark)


def cell_map_chart(profile: Profile, stops: Sequence[PlannedStop]) -> Chart:
    """Show bases, tracker, obstacles, and the SMR at planned and measured stops from above in the cell frame C [m].

    The geometry is the nominal one.
    """
    pose = profile.tracker.pose
    bases = {name: pose_matrix(arm.base) for name, arm in profile.arms.items() if arm.base is not None}
    if pose is None or not bases:
        message = "No map: the profile does not say where bases and tracker are (arms.*.base, tracker.pose)."
        return Chart(_TITLE, *_AXES, (), message)
    T_C_M = pose_matrix(pose)
    smr = {name: _smr_positions(profile, name, T_C_B, stops) for name, T_C_B in bases.items()}
    origins = np.array([T_C_B[:3, 3] for T_C_B in bases.values()])
    points = [
        *_stop_marks(smr, stops),
        _points("base", origins, "B", _OTHER_STYLE),
        _points("tracker", T_C_M[np.newaxis, :3, 3], "T", _OTHER_STYLE),
    ]
    lines = obstacle_series(outlined_obstacles(profile).values())
    message = _message(smr, stops, T_C_M)
    return Chart(_TITLE, *_AXES, (*lines, *(one for one in points if len(one.x))), message, equal=True)


def _smr_positions(profile: Profile, name: str, T_C_B: Array, stops: Sequence[PlannedStop]) -> Array:
    """Compute the nominal SMR positions (n, 3) of one arm in C [m] at all stops."""
    geometry = nominal_arm(profile.arms[name]).with_T_M_B(T_C_B)
    return smr_positions(geometry, np.array([stop.q[name] for stop in stops]).reshape(-1, geometry.joints))


def _stop_marks(smr: Mapping[str, Array], stops: Sequence[PlannedStop]) -> Iterator[Series]:
    measured = np.array([stop.measured for stop in stops], dtype=np.bool_)
    for style, (name, p_C) in enumerate(smr.items()):
        shape = style % len(_PLANNED)
        yield _points(f"{name} planned", p_C[~measured], _PLANNED[shape], style)
        yield _points(f"{name} measured", p_C[measured], _MEASURED[shape], style)


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
