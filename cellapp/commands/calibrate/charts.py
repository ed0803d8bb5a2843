"""Charts of accuracy: held-out errors by stage, over the joints and in space, and of the pair.

The errors of an arm are ``HeldOutArm.errors_mm``; its first use runs the prediction of every model.

Charts of residuals as enlarged arrows, from above and from the side.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from cellapp.commands.calibrate.held_out import HeldOutArm
from cellapp.commands.calibrate.view import cooperative_noise_mm
from cellapp.commands.view.charts import (
    SMALLEST_MM,
    STAGE_STYLES,
    Axis,
    Chart,
    Key,
    drawable_mm,
    evenly_spread,
    noise_limit,
    series,
)
from cellapp.commands.view.words import METHOD_WORDS, STAGE_WORDS
from cellapp.estimation.calibration.records import CalibrateResult, PairHeldOut
from cellapp.ground.counting import counted, mm
from cellapp.ground.results import STAGES, Method
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, invert

_METHOD_STYLES: Mapping[Method, int] = {"method_1": 1, "method_2": 4, "proposed": 2, "effects": 3}
"""Styles of the methods of the pair: each has the style of the stage that it builds on."""
_NO_HELD_OUT = "No held-out readings: calibrate first."


def pair_held_out(calibrate: CalibrateResult) -> dict[Method, PairHeldOut]:
    """Return the errors of the held-out stops by method of the pair, for methods that stored them by stop."""
    found = {method: calibrate.pair[method].held_out for method in _METHOD_STYLES if method in calibrate.pair}
    return {method: stops for method, stops in found.items() if stops is not None}


# -- errors stop by stop ----------------------------------------------------------------------------------------------


def stop_error_chart(name: str, held_out: HeldOutArm, floor_mm: float | None) -> Chart:
    """Show the position error of each held-out configuration by stage, with the noise floor."""
    title = f"Arm {name}: position error of each held-out configuration"
    stops = held_out.readings.configuration
    errors: dict[str, tuple[NDArray[np.int64], Array]] = {
        stage: (stops, held_out.errors_mm[stage]) for stage in STAGES if stage in held_out.errors_mm
    }
    return _stop_errors(title, "position error", errors, STAGE_STYLES, STAGE_WORDS, floor_mm)


def pair_stop_chart(calibrate: CalibrateResult) -> Chart:
    """Show the cooperative error of each held-out stop by method of the pair, with the tracker's noise."""
    errors = {
        method: (np.array(stops.configuration), np.array(stops.cooperative_mm))
        for method, stops in pair_held_out(calibrate).items()
    }
    title, floor = "Pair: cooperative error of each held-out stop", cooperative_noise_mm(calibrate)
    return _stop_errors(title, "cooperative error", errors, _METHOD_STYLES, METHOD_WORDS, floor)


def _stop_errors(
    title: str,
    label: str,
    errors_mm: Mapping[Key, tuple[NDArray[np.int64], Array]],
    style: Mapping[Key, int],
    words: Mapping[Key, str],
    floor_mm: float | None,
) -> Chart:
    """Show errors over the stops at which each model was judged: models may leave out different gross errors."""
    x, y = Axis("configuration"), Axis(label, "mm", logarithmic=True)
    if not errors_mm or not all(len(stops) for stops, _ in errors_mm.values()):
        return Chart(title, x, y, (), _NO_HELD_OUT)
    drawn = tuple(
        series(key, stops, drawable_mm(errors), "points", style=style[key])
        for key, (stops, errors) in errors_mm.items()
    )
    first, last = next(iter(errors_mm)), list(errors_mm)[-1]
    (_, before), (stops, after) = errors_mm[first], errors_mm[last]
    worst = int(np.argmax(after))
    message = (
        f"The largest of {counted(len(stops), 'error')} is {mm(float(after[worst]))} ({words[last]}), at {stops[worst]}"
    )
    if last != first:
        message += f"; it was {mm(float(before.max()))} ({words[first]})"
    return Chart(title, x, y, drawn, f"{message}.", noise_limit(floor_mm), by_stage=True)


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
        f" {mm(float(lengths[worst]))} at ({x:z.2f}, {y:z.2f}, {z:z.2f}) m; {direction} (mean vector {mm(common)})."
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
