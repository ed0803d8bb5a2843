"""The figure of the chapter on planning: its own example of obstacles, and the directions that these hide."""

from __future__ import annotations

import re
from importlib import resources

import numpy as np
import yaml
from pydantic import TypeAdapter

from cellapp.commands.plan.charts_obstacles import (
    blocked_directions,
    obstacle_series,
    outlined_obstacles,
    shadow_series,
)
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Obstacles
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import pose_matrix
from tests.handbook.chart import Chart, Series, chart_svg

FIGURE = "obstacles"
"""Stem of the figure's file."""
_EXAMPLE = re.compile(r"```yaml\nobstacles:\n(.*?)```", re.DOTALL)
_OBSTACLES: TypeAdapter[Obstacles] = TypeAdapter(Obstacles)
_REACH_M = np.array([[x, y, z] for x in (0.0, 0.8) for y in (-1.2, 1.2) for z in (0.0, 1.2)])
"""About where the SMRs of two arms are measured, in the cell frame C."""


def example_obstacles() -> Obstacles:
    """The obstacles of the chapter's example."""
    text = resources.files("cellapp.docs").joinpath("planning.md").read_text("utf-8")
    match = _EXAMPLE.search(text)
    assert match is not None
    return _OBSTACLES.validate_python(yaml.safe_load(match[1]))


def obstacles_chart(profile: Profile) -> Chart:
    """The example from above in the cell of a profile, in the cell frame C [m].

    Raises
    ------
    InputError
        If the profile does not say where its bases and its tracker are, or has other arms than the example.
    """
    pose, bases = profile.tracker.pose, [arm.base for arm in profile.arms.values() if arm.base is not None]
    obstacles = example_obstacles()
    if pose is None or len(bases) < len(profile.arms):
        raise InputError(f"{profile.name}: figures need the poses of the tracker and of all bases")
    if unknown := {one.arm for one in obstacles.values() if one.arm is not None} - set(profile.arms):
        raise InputError(f"{profile.name}: the figure of obstacles needs arms named {', '.join(sorted(unknown))}")
    T_C_M = pose_matrix(pose)
    outlined = outlined_obstacles(profile.model_copy(update={"obstacles": obstacles}))
    lines = [
        *obstacle_series(outlined, None, "above"),
        *shadow_series(blocked_directions(outlined, T_C_M, _REACH_M), T_C_M, _REACH_M),
    ]
    stands: Array = np.array([pose.position, *(base.position for base in bases)])
    return Chart(
        "Obstacles from above, and the directions that they hide from the tracker",
        "x [m]",
        "y [m]",
        (
            *(Series(one.name, one.x, one.y) for one in lines),
            Series("tracker and bases", stands[:, 0], stands[:, 1], "points"),
        ),
        equal=True,
    )


def figure_svg(profile: Profile) -> str:
    """The figure as the text of an SVG file."""
    return chart_svg(obstacles_chart(profile))
