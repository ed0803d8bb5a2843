"""Charts of residuals as enlarged arrows, from above and from the side."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cellapp.commands.calibrate.held_out import HeldOutArm
from cellapp.commands.view.charts import SMALLEST_MM, STAGE_STYLES, Array, Axis, Chart, evenly_spread, mm, series
from cellapp.ground.counting import counted
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import apply, invert

_MOST_ARROWS = 150
"""Most arrows of each arm: more overlap."""
_ARROW = 0.18
"""Length of the scale arrow as a share of the drawn range: shorter ones hide differences, longer ones overlap."""
_HEAD = 0.03
"""Longest head of an arrow, as a share of the drawn range."""
_OTHER_STYLE = 5
"""Style of series that are no residuals."""


def vector_charts(name: str, held_out: HeldOutArm) -> Iterator[Chart]:
    """Yield residuals of one arm's identified geometry: from above in the tracker frame, two views in its base
    frame."""
    readings, geometry = held_out.readings, held_out.calibrated.geometry
    shown = readings.take(evenly_spread(len(readings), _MOST_ARROWS))
    residual_M = shown.p_M - smr_positions(geometry, shown.q)
    T_B_M = invert(geometry.T_M_B())
    title = f"Arm {name}: residuals of the geometry in"
    yield vector_chart(f"{title} the tracker frame, from above", shown.p_M, residual_M, 1)
    points_B, residual_B = apply(T_B_M, shown.p_M), residual_M @ T_B_M[:3, :3].T
    yield vector_chart(f"{title} its base frame, from above", points_B, residual_B, 1)
    yield vector_chart(f"{title} its base frame, from the side", points_B, residual_B, 2)


def vector_chart(title: str, points: Array, vectors: Array, up: int) -> Chart:
    """Show vectors (n, 3) [m] at points (n, 3) [m], with x to the right and axis ``up`` (1 or 2) upwards, enlarged."""
    length_mm = scale_length_mm(vectors)
    reach = float(np.max(np.ptp(points, axis=0))) or 1.0
    enlarged = _ARROW * reach / (length_mm * 1e-3)
    flat, steps = points[:, (0, up)], vectors[:, (0, up)] * enlarged
    ends = np.vstack([flat, flat + steps])
    corner = np.array([[ends[:, 0].min(), ends[:, 1].max() + 0.1 * reach]])
    arrows, key = _arrows(flat, steps, _HEAD * reach), np.array([[_ARROW * reach, 0.0]])
    scale = _arrows(corner, key, _HEAD * reach)
    drawn = (
        series("measured minus computed position", arrows[:, 0], arrows[:, 1], style=STAGE_STYLES["geometry"]),
        series("measured position", flat[:, 0], flat[:, 1], "points", style=STAGE_STYLES["nominal"]),
        series(f"scale: {length_mm:g} mm", scale[:, 0], scale[:, 1], style=_OTHER_STYLE, mark="→"),
    )
    x, y = Axis("x", "m"), Axis("xyz"[up], "m")
    return Chart(title, x, y, drawn, _message(points, vectors), equal=True, by_stage=True)


def _message(points: Array, vectors: Array) -> str:
    """State the size of the vectors, and whether they share a direction."""
    lengths = np.linalg.norm(vectors, axis=1) * 1e3
    common = float(np.linalg.norm(vectors.mean(axis=0))) * 1e3
    worst = int(np.argmax(lengths))
    x, y, z = points[worst]
    direction = "they point in all directions" if common < 0.5 * float(lengths.mean()) else "most point the same way"
    return (
        f"Residuals at {counted(len(vectors), 'held-out stop')} are"
        f" {mm(float(lengths.mean()))} long on average, the longest"
        f" {mm(float(lengths[worst]))} at ({x:.2f}, {y:.2f}, {z:.2f}) m; {direction} (mean vector {mm(common)})."
    )


def _arrows(starts: Array, steps: Array, head: float) -> Array:
    """Return arrows (n, 2) as lines (6 n, 2) with gaps; heads have at most the length ``head``."""
    length = np.linalg.norm(steps, axis=1, keepdims=True)
    along = steps / np.maximum(length, 1e-12) * np.minimum(head, 0.5 * length)
    across = np.column_stack([-along[:, 1], along[:, 0]]) * 0.5
    tips = starts + steps
    gap = np.full_like(tips, np.nan)
    return np.stack([starts, tips, tips - along + across, tips, tips - along - across, gap], axis=1).reshape(-1, 2)


def scale_length_mm(vectors: Array) -> float:
    """Return a round length [mm] near the 90th percentile of the lengths of ``vectors`` (n, 3) [m]."""
    large = max(float(np.quantile(np.linalg.norm(vectors, axis=1), 0.9)) * 1e3, SMALLEST_MM)
    decade = 10.0 ** np.floor(np.log10(large))
    return float(f"{decade * max(step for step in (1.0, 2.0, 5.0) if step * decade <= large * (1.0 + 1e-9)):.3g}")
