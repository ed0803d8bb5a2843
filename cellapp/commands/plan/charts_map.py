"""Maps of the cell: bases, tracker, stops and obstacles from above, and as the tracker sees them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.commands.plan.charts_obstacles import (
    Blocked,
    View,
    blocked_directions,
    obstacle_series,
    outlined_obstacles,
    seen_from,
    shadow_series,
)
from cellapp.commands.plan.result import PlannedStop
from cellapp.commands.view.charts import Axis, Chart, Series, enumerated, series
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import nominal_arm, pose_matrix

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


def cell_map_chart(
    profile: Profile, stops: Sequence[PlannedStop], view: View = "above", current: int | None = None
) -> Chart:
    """Show bases, tracker, obstacles, and the SMR at planned and measured stops, with the nominal geometry.

    From above in the cell frame C [m], with the outermost rays of the tracker to each arm's stops and the directions
    that obstacles block; or as azimuth and elevation [deg] in the tracker frame M. ``current`` is the number of the
    stop to which the arms are moving.
    """
    pose = profile.tracker.pose
    bases = {name: pose_matrix(arm.base) for name, arm in profile.arms.items() if arm.base is not None}
    if pose is None or not bases:
        message = "No map: the profile does not say where bases and tracker are (arms.*.base, tracker.pose)."
        return Chart(_TITLES[view], *_AXES[view], (), message)
    T_C_M = pose_matrix(pose)
    smr = {name: _smr_positions(profile, name, T_C_B, stops) for name, T_C_B in bases.items()}
    things = [*_stop_marks(smr, stops, current)]
    things.append(_Marks("base", np.array([T_C_B[:3, 3] for T_C_B in bases.values()]), "B", _OTHER_STYLE))
    if view == "above":
        things.append(_Marks("tracker", T_C_M[:3, 3][np.newaxis], "T", _OTHER_STYLE))
    points = [thing.series(T_C_M, view) for thing in things if len(thing.p_C)]
    obstacles, everywhere = outlined_obstacles(profile), np.concatenate(list(smr.values()))
    blocked = blocked_directions(obstacles, T_C_M, everywhere)
    lines = list(obstacle_series(obstacles, T_C_M, view))
    if view == "above":
        lines = [*_rays(smr, T_C_M), *shadow_series(blocked, T_C_M, everywhere), *lines]
    message = _message(smr, stops, T_C_M, blocked)
    return Chart(_TITLES[view], *_AXES[view], (*lines, *points), message, equal=view == "above")


def _smr_positions(profile: Profile, name: str, T_C_B: Array, stops: Sequence[PlannedStop]) -> Array:
    """Compute the nominal SMR positions (n, 3) of one arm in C [m] at all stops."""
    geometry = nominal_arm(profile.arms[name]).with_T_M_B(T_C_B)
    return smr_positions(geometry, np.array([stop.q[name] for stop in stops]).reshape(-1, geometry.joints))


def _stop_marks(smr: Mapping[str, Array], stops: Sequence[PlannedStop], current: int | None) -> Iterator[_Marks]:
    measured = np.array([stop.measured for stop in stops], dtype=np.bool_)
    now = np.array([stop.configuration == current for stop in stops], dtype=np.bool_)
    for style, (name, p_C) in enumerate(smr.items()):
        shape = style % len(_PLANNED)
        yield _Marks(f"{name} planned", p_C[~measured], _PLANNED[shape], style)
        yield _Marks(f"{name} measured", p_C[measured], _MEASURED[shape], style)
    if now.any():
        yield _Marks("moving to", np.concatenate([p_C[now] for p_C in smr.values()]), "X", _OTHER_STYLE)


def _rays(smr: Mapping[str, Array], T_C_M: Array) -> Iterator[Series]:
    """Yield the outermost rays from the tracker to each arm's stops, from above: the range that it turns through."""
    tracker, lines = T_C_M[:2, 3], []
    for p_C in smr.values():
        if len(p_C):
            azimuth = seen_from(p_C, T_C_M, "tracker")[:, 0]
            ends = p_C[[int(np.argmin(azimuth)), int(np.argmax(azimuth))], :2]
            lines += [ends[0], tracker, ends[1], np.full(2, np.nan)]
    if lines:
        x, y = np.array(lines).T
        yield series("outermost rays", x, y, style=_OTHER_STYLE, mark="·")


def _message(smr: Mapping[str, Array], stops: Sequence[PlannedStop], T_C_M: Array, blocked: Sequence[Blocked]) -> str:
    """Say how many stops are measured, how far they are from the tracker, and which obstacles block its view."""
    if not stops:
        return f"Bases of {enumerated(smr)} and the tracker; no stops yet: plan first."
    away = np.linalg.norm(np.concatenate(list(smr.values())) - T_C_M[:3, 3], axis=1)
    measured = sum(stop.measured for stop in stops)
    hidden = [f"{one.name} from azimuth {one.azimuth_deg[0]:.0f} to {one.azimuth_deg[1]:.0f} deg" for one in blocked]
    return (
        f"{measured} of {counted(len(stops), 'planned stop is', 'planned stops are')} measured; they are"
        f" {away.min():.1f} to {away.max():.1f} m from"
        f" the tracker.{f' Beams are blocked by {enumerated(hidden)}.' if hidden else ''}"
    )
