"""The calibrated cell of a run: its scene in space and its maps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.commands.calibrate.charts_vectors import scale_length_mm
from cellapp.commands.calibrate.held_out import HeldOutArm
from cellapp.commands.plan.charts_obstacles import placed_obstacles
from cellapp.commands.report.data import ReportData
from cellapp.commands.view.charts import Axis, Chart, Series, evenly_spread, levelling_rotation, series
from cellapp.commands.view.parts import Capsules, CellScene, ErrorVectors, SceneArm
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Arm
from cellapp.robot.kinematics.chain import frame_poses, smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, invert
from cellapp.robot.model.nominal import pose_matrix

_MOST_POINTS = 400
"""Most measured positions drawn of each arm: more add kilobytes and no shape."""
_MOST_VECTORS = 150
"""Most error vectors drawn of each arm: more overlap."""
_LONG = 0.12
"""Drawn length of the larger errors, as a share of the range of the measured positions."""
_OTHER_STYLE = 4
"""Style of series that belong to no arm."""


def cell_scene(data: ReportData) -> CellScene:
    """Build the scene of a calibrated run, with the newest model that holds."""
    level = levelling_rotation(next(iter(data.model.arms.values())).up_M)
    stops = typical_stops(data.readings)
    arms = tuple(_scene_arm(data, name, stops[name], level) for name in data.model.arms)
    return CellScene(arms, _obstacles(data, level), _enlargement(arms))


def cell_maps(scene: CellScene) -> list[Chart]:
    """Show the cell from above and from the side, in the tracker frame with its z axis up."""
    # seen from the side, the line from the tracker to the arms has its full length
    across = int(np.argmax(np.abs(np.mean([arm.base for arm in scene.arms], axis=0))[:2]))
    return [
        plane_chart(scene, "The cell from above", 0, 1),
        plane_chart(scene, "The cell from the side", across, 2),
    ]


def plane_chart(scene: CellScene, title: str, across: int, up: int) -> Chart:
    """Show measured positions, bases and tracker in a plane: axis ``across`` to the right, ``up`` upwards (0, 1, 2)."""
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


def _scene_arm(data: ReportData, name: str, stop: int, level: Array) -> SceneArm:
    geometry, measured = data.model.arms[name].geometry, data.readings[name]
    rotations, origins = frame_poses(geometry, measured.take([stop]).q)
    chain = np.vstack([origins[:, 0], smr_positions(geometry, measured.take([stop]).q)])
    shown = measured.take(evenly_spread(len(measured), _MOST_POINTS))
    return SceneArm(
        name=name,
        base=level @ origins[0, 0],
        chain=chain @ level.T,
        bodies=_bodies(data.profile.arms[name], level @ rotations[:, 0], origins[:, 0] @ level.T),
        points=shown.p_M @ level.T,
        stops=shown.configuration,
        errors=_errors(data.held_out[name], level),
    )


def _bodies(arm: Arm, rotations: Array, origins: Array) -> Capsules:
    """Place the capsules of an arm's type on its frames: rotations (N + 1, 3, 3), origins (N + 1, 3) [m]."""
    capsules = [one for one in arm.type.capsules if one.frame < len(origins)]
    frames = np.array([one.frame for one in capsules], dtype=np.int64)
    ends = [np.array([getattr(one, end) for one in capsules]).reshape(-1, 3) for end in ("start", "end")]
    start, end = (origins[frames] + np.einsum("mab,mb->ma", rotations[frames], points) for points in ends)
    return Capsules(start, end, np.array([one.radius for one in capsules], dtype=np.float64))


def _errors(held_out: HeldOutArm, level: Array) -> tuple[ErrorVectors, ...]:
    """Return the error vectors of the first and of the last stage."""
    readings, computed = held_out.readings, held_out.computed_M
    rows = evenly_spread(len(readings), _MOST_VECTORS)
    stages = list(computed)
    points, stops = readings.p_M[rows], readings.configuration[rows]
    return tuple(
        ErrorVectors(stage, points @ level.T, (points - computed[stage][rows]) @ level.T, stops)
        for stage in dict.fromkeys((stages[0], stages[-1]))
        if len(rows)
    )


def _obstacles(data: ReportData, level: Array) -> dict[str, Array]:
    """Return the fixed obstacles whose pose in the tracker frame is known."""
    pose = data.profile.tracker.pose
    if pose is None:
        return {}
    bases = {name: pose_matrix(arm.base) for name, arm in data.profile.arms.items() if arm.base is not None}
    T_M_C = invert(pose_matrix(pose))
    placed = placed_obstacles(data.profile.obstacles, bases, {})
    return {one.name: apply(T_M_C, one.p_C) @ level.T for one in placed}


def _enlargement(arms: tuple[SceneArm, ...]) -> float:
    """Return a round factor that makes the larger errors before calibration visible."""
    first = [arm.errors[0].steps for arm in arms if arm.errors]
    if not first:
        return 1.0
    reach = max(float(np.ptp(arm.points, axis=0).max()) for arm in arms) or 1.0
    wanted = _LONG * reach / (scale_length_mm(np.vstack(first)) * 1e-3)
    return float(f"{wanted:.1g}")


def typical_stops(readings: Mapping[str, Readings]) -> dict[str, int]:
    """Return a row of each arm with joints near their medians; rows of one common stop if the arms share a stop."""
    off = {name: np.linalg.norm(arm.q - np.median(arm.q, axis=0), axis=1) for name, arm in readings.items()}
    common = set.intersection(*(set(arm.configuration.tolist()) for arm in readings.values()))
    if not common:
        return {name: int(np.argmin(values)) for name, values in off.items()}
    row_of_stop = {
        name: {stop: row for row, stop in enumerate(arm.configuration.tolist())} for name, arm in readings.items()
    }
    best = min(sorted(common), key=lambda stop: sum(float(off[name][row_of_stop[name][stop]]) for name in off))
    return {name: row_of_stop[name][best] for name in readings}
