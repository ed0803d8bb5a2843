"""Charts of a plan before it is measured: expected errors, joint ranges, time, correlations.

Obstacles in maps of the cell: outlines from above and from the tracker, and the directions that they block.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellapp.cell.driving.records import PlannedStop
from cellapp.cell.planning.candidates import joint_ranges
from cellapp.cell.planning.records import ArmDesign, PlanDesignResult, PlannedTime, PlanQuality, TravelTime
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.shapes import load_mesh
from cellapp.commands.view.charts import Axis, Chart, Series, bar_chart, enumerated, series
from cellapp.ground.counting import counted, mm
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
from cellapp.ground.progress import duration_words
from cellapp.robot.kinematics.chain import flange_poses, smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, invert
from cellapp.robot.model.nominal import nominal_arm, pose_matrix

_EQUAL = {"parameters": "parameters", "mean": "mean error", "worst": "worst error"}
_MEAN, _WORST, _OTHER_STYLE = 0, 1, 4


def design_charts(design: PlanDesignResult | None, time: PlannedTime | None) -> tuple[Chart, ...]:
    """Show each arm's expected errors by stops, and the time; only the time without a design (None)."""
    if design is None:
        return (time_chart(None, time),)
    told = (information_chart(name, arm) for name, arm in design.arms.items())
    return (*told, time_chart(design.travel, time))


# -- information ------------------------------------------------------------------------------------------------------


def information_chart(name: str, arm: ArmDesign) -> Chart:
    """Show the expected position error after the first n stops, mean and worst point, beside random plans."""
    stops = [one.stops for one in arm.by_stops]
    random = arm.random
    drawn = (
        series("mean", stops, [one.mean_mm for one in arm.by_stops], style=_MEAN),
        series("worst point", stops, [one.worst_mm for one in arm.by_stops], style=_WORST),
        series("mean, random stops", [random.stops], [random.mean_mm], "points", style=_MEAN, mark="○"),
        series("worst point, random stops", [random.stops], [random.worst_mm], "points", style=_WORST, mark="△"),
    )
    axes = Axis("stops"), Axis("expected error", "mm", logarithmic=True)
    return Chart(f"Arm {name}: what the first stops tell", *axes, drawn, _information_message(name, arm))


def _information_message(name: str, arm: ArmDesign) -> str:
    designed = arm.designed
    equal = [f"{stops:.0f} in {_EQUAL[what]}" for what, stops in arm.equal_to_random.items()]
    early = next((one for one in arm.by_stops if 4 * one.stops >= designed.stops), None)
    sentences = [f"Arm {name}: {counted(designed.stops, 'stop gives', 'stops give')} {_errors(designed)}"]
    if equal:
        sentences.append(f"They tell as much as random stops: {enumerated(equal)}")
    if early is not None and early.stops < designed.stops:
        sentences.append(f"After {counted(early.stops, 'stop')} {_errors(early)}")
    return ". ".join(sentences) + "."


def _errors(quality: PlanQuality) -> str:
    return f"{mm(quality.mean_mm)} on average, {mm(quality.worst_mm)} at the worst point"


# -- joints -----------------------------------------------------------------------------------------------------------


def coverage_charts(profile: Profile, stops: Sequence[PlannedStop]) -> tuple[Chart, ...]:
    """Show the joint ranges of every arm and the stops in them; none if the profile does not describe the cell."""
    try:
        cell = cell_bodies(profile)
        allowed = {name: joint_ranges(cell, profile, name) for name in cell.arms}
    except InputError:
        return ()
    return tuple(
        coverage_chart(name, ranges, np.array([stop.q[name] for stop in stops]).reshape(-1, len(ranges)))
        for name, ranges in allowed.items()
    )


def coverage_chart(name: str, allowed: Array, q: Array) -> Chart:
    """Show each joint's allowed range (N, 2) [rad] of one arm, the stops (n, N) [rad] in it, and the largest gap."""
    axes = Axis("joint position", "deg"), Axis("joint")
    title = f"Arm {name}: joint ranges"
    if not len(q):
        return Chart(title, *axes, (), f"Arm {name}: no stops yet.")
    joints = np.arange(1.0, q.shape[1] + 1.0)
    degrees, limits = np.degrees(q), np.degrees(allowed)
    gaps = np.array([_largest_gap(column) for column in degrees.T])
    drawn = (
        series("allowed", *_segments(limits, joints), style=_OTHER_STYLE, mark="·"),
        series("stops", degrees.ravel(), np.tile(joints, len(q)), "points", style=_MEAN),
        series("largest gap", *_segments(gaps, joints), style=_WORST, mark="×"),
    )
    used = np.ptp(degrees, axis=0) / np.maximum(np.ptp(limits, axis=1), 1e-9)
    widest, least = int(np.argmax(np.ptp(gaps, axis=1))), int(np.argmin(used))
    message = (
        f"Arm {name}: the largest part of a travelled range without a stop is {np.ptp(gaps[widest]):.0f} deg, of joint"
        f" {widest + 1}; joint {least + 1} uses the least of its range, {100.0 * used[least]:.0f} %."
    )
    return Chart(title, *axes, drawn, message)


def _largest_gap(values: Array) -> tuple[float, float]:
    """Return the two neighbouring values of (n,) with the largest gap between them."""
    ordered = np.sort(values)
    if len(ordered) < 2:
        return float(ordered[0]), float(ordered[0])
    at = int(np.argmax(np.diff(ordered)))
    return float(ordered[at]), float(ordered[at + 1])


def _segments(ends: Array, height: Array) -> tuple[Array, Array]:
    """Return horizontal lines between ends (m, 2) at heights (m,), with NaN gaps between them."""
    x = np.column_stack([ends, np.full(len(ends), np.nan)])
    return x.ravel(), np.repeat(height, 3)


# -- time -------------------------------------------------------------------------------------------------------------


def time_chart(travel: TravelTime | None, time: PlannedTime | None) -> Chart:
    """Show how the time of collecting is spent, and the motions in a random order too. None: not known."""
    bars = {} if time is None else {"motions": time.moving_s}
    if travel is not None:
        bars = {"motions": travel.planned_s, "in random order": travel.random_order_s}
    if time is not None:
        rest = {"rests": time.resting_s, "measuring": time.measuring_s}
        bars |= rest | {"references": time.references_s, "warm-up": time.warm_up_s}
    shown = {name: (seconds / 60.0, duration_words(seconds)) for name, seconds in bars.items() if seconds > 0.0}
    sentences = [] if time is None else [f"Collecting takes about {duration_words(time.total_s)}."]
    if travel is not None and travel.saved >= 0.005:
        sentences.append(f"The order of the stops saves {100.0 * travel.saved:.0f} % of the motions' time.")
    return bar_chart("Time of the plan", shown, Axis("time", "min"), " ".join(sentences) or "Time is not known yet.")


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
