"""Map of bases, tracker and obstacles while their poses are being entered: those known so far."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.commands.plan.charts_obstacles import Outlined, obstacle_series, placed_obstacles
from cellapp.commands.view.charts import Axis, Chart, Series, enumerated, series
from cellapp.ground.profile import Pose
from cellapp.ground.profile.obstacles import AnyObstacle
from cellapp.robot.model.nominal import pose_matrix

_AXIS_M = 0.4
"""Length of the line along a frame's x axis: visible in a map of some metres."""
_OTHER_STYLE = 4
"""Style of series that belong to no arm; as in ``charts_obstacles``."""


def placement_chart(
    bases: Mapping[str, Pose | None], tracker: Pose | None, obstacles: Mapping[str, AnyObstacle] | None = None
) -> Chart:
    """Show bases and tracker from above in the cell frame C [m], each with its x axis; None: pose not known yet.

    Obstacles on a flange are left out: they move with the arm.
    """
    axes = (Axis("x", "m"), Axis("y", "m"))
    known = {name: pose for name, pose in bases.items() if pose is not None}
    placed = placed_obstacles(obstacles or {}, {name: pose_matrix(pose) for name, pose in known.items()}, {})
    lines = [line for style, name in enumerate(bases) if name in known for line in _frame(name, known[name], style)]
    lines += [] if tracker is None else _frame("tracker", tracker, _OTHER_STYLE, "T")
    lines += obstacle_series(placed, None, "above")
    if not lines:
        return Chart("The cell from above", *axes, (), "No map yet: write positions of bases and tracker.")
    return Chart("The cell from above", *axes, tuple(lines), _message(known, tracker, placed), equal=True)


def _frame(name: str, pose: Pose, style: int, mark: str = "B") -> list[Series]:
    T_C_X = pose_matrix(pose)
    origin, tip = T_C_X[:2, 3], T_C_X[:2, 3] + _AXIS_M * T_C_X[:2, 0]
    x_axis = series(f"{name} x axis", [origin[0], tip[0]], [origin[1], tip[1]], style=style)
    return [x_axis, series(name, origin[:1], origin[1:], "points", style=style, mark=mark)]


def _message(bases: Mapping[str, Pose], tracker: Pose | None, obstacles: list[Outlined]) -> str:
    words = [f"{name} at {pose.position[0]:.2f}, {pose.position[1]:.2f} m" for name, pose in bases.items()]
    if tracker is not None and bases:
        away = [np.linalg.norm(np.subtract(pose.position, tracker.position)) for pose in bases.values()]
        words.append(f"the tracker, at least {min(away):.1f} m from the bases")
    elif tracker is not None:
        words.append("the tracker")
    words += [one.name for one in obstacles]
    return f"From above: {enumerated(words)}."
