"""The page's figures of the cell: in space, from above, from the side."""

from __future__ import annotations

import numpy as np

from cellapp.commands.report.data import ReportData
from cellapp.commands.view.charts import Axis, Chart, Series, series
from cellapp.interfaces.page.captioned import CaptionedFigure
from cellapp.interfaces.page.cell_figures import scene_figure
from cellapp.interfaces.page.cell_scene import CellScene, cell_scene
from cellapp.interfaces.page.chart_figure import chart_figure

_OTHER_STYLE = 4
"""Style of what belongs to no arm."""


def cell_views(data: ReportData) -> list[CaptionedFigure]:
    """The cell in space, from above and from the side, in the tracker frame with its z axis up."""
    scene = cell_scene(data)
    # the side view shows the line from the tracker to the arms at full length
    across = int(np.argmax(np.abs(np.mean([arm.base for arm in scene.arms], axis=0))[:2]))
    return [
        scene_figure("cell-space", scene),
        chart_figure("cell-top", plane_chart(scene, "The cell from above", 0, 1)),
        chart_figure("cell-side", plane_chart(scene, "The cell from the side", across, 2)),
    ]


def plane_chart(scene: CellScene, title: str, across: int, up: int) -> Chart:
    """Measured positions, bases and tracker along one axis: ``across`` to the right, ``up`` upwards, as 0, 1, 2."""
    drawn: list[Series] = []
    for style, arm in enumerate(scene.arms):
        hints = [f"stop {stop}" for stop in arm.stops.tolist()]
        x, y = arm.points[:, across], arm.points[:, up]
        drawn.append(series(f"arm {arm.name}", x, y, "points", style=style, hints=hints))
    bases = np.array([arm.base for arm in scene.arms])
    names = [arm.name for arm in scene.arms]
    drawn.append(series("bases", bases[:, across], bases[:, up], "points", style=_OTHER_STYLE, mark="B", hints=names))
    drawn.append(series("tracker", [0.0], [0.0], "points", style=_OTHER_STYLE, mark="T"))
    axes = (Axis("xyz"[across], "m"), Axis("xyz"[up], "m"))
    return Chart(title, *axes, tuple(drawn), _plane_message(scene, across, up), equal=True)


def _plane_message(scene: CellScene, across: int, up: int) -> str:
    words = []
    for arm in scene.arms:
        width, height = np.ptp(arm.points[:, (across, up)], axis=0)
        words.append(f"{width:.1f} m along {'xyz'[across]} and {height:.1f} m along {'xyz'[up]} (arm {arm.name})")
    return f"Measured positions span {'; '.join(words)}."
