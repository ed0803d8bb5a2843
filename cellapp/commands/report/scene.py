"""The calibrated cell of a run: maps from above and from the side."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.commands.report.data import ReportData
from cellapp.commands.view.charts import Axis, Chart, evenly_spread, levelling_rotation, series
from cellapp.robot.kinematics.transforms import Array

_MOST_POINTS = 400
"""Most measured positions drawn of each arm: more add kilobytes and no shape."""
_OTHER_STYLE = 4
"""Style of series that belong to no arm."""


def cell_maps(data: ReportData) -> list[Chart]:
    """Show measured positions, bases and tracker in the tracker frame with its z axis up."""
    level = levelling_rotation(next(iter(data.model.arms.values())).up_M)
    bases = np.array([level @ arm.geometry.T_M_B()[:3, 3] for arm in data.model.arms.values()])
    points = {}
    for name in data.model.arms:
        p_M = data.readings[name].p_M
        points[name] = p_M[evenly_spread(len(p_M), _MOST_POINTS)] @ level.T
    # seen from the side, the line from the tracker to the arms has its full length
    across = int(np.argmax(np.abs(bases.mean(axis=0))[:2]))
    return [
        _plane_chart(points, bases, "The cell from above", 0, 1),
        _plane_chart(points, bases, "The cell from the side", across, 2),
    ]


def _plane_chart(points: Mapping[str, Array], bases: Array, title: str, across: int, up: int) -> Chart:
    """Show points (n, 3) and bases (m, 3) [m] in a plane: axis ``across`` to the right, ``up`` upwards (0, 1, 2)."""
    drawn, words = [], []
    for style, (name, p) in enumerate(points.items()):
        drawn.append(series(f"arm {name}", p[:, across], p[:, up], "points", style=style))
        width, height = np.ptp(p[:, (across, up)], axis=0)
        words.append(f"{width:.1f} m along {'xyz'[across]} and {height:.1f} m along {'xyz'[up]} (arm {name})")
    drawn.append(series("bases", bases[:, across], bases[:, up], "points", style=_OTHER_STYLE, mark="B"))
    drawn.append(series("tracker", [0.0], [0.0], "points", style=_OTHER_STYLE, mark="T"))
    axes = (Axis("xyz"[across], "m"), Axis("xyz"[up], "m"))
    return Chart(title, *axes, tuple(drawn), f"Measured positions span {'; '.join(words)}.", equal=True)
