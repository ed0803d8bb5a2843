"""Maps of the share of each arm's workspace that the tracker sees, from above and from the tracker, as shades."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from cellapp.cell.planning.records import FEW_CONFIGURATIONS, ArmView, ViewResult
from cellapp.commands.view.charts import Array, Axis, Chart, Series, series
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import apply, invert
from cellapp.robot.model.nominal import pose_matrix

SeenFrom = Literal["above", "tracker"]

SHADES = "·░▒▓█"
"""Marks of the shares: zero, then each quarter of the largest share."""
_OTHER_STYLE = 4
"""Style of series that belong to no arm; as in ``charts_obstacles``."""
_AXES: Mapping[SeenFrom, tuple[Axis, Axis]] = {
    "above": (Axis("x", "m"), Axis("y", "m")),
    "tracker": (Axis("azimuth", "deg"), Axis("elevation", "deg")),
}
_TITLES: Mapping[SeenFrom, str] = {"above": "seen from above", "tracker": "as the tracker sees it"}


def view_charts(profile: Profile, view: ViewResult) -> tuple[Chart, ...]:
    """Show both maps of every arm."""
    return tuple(view_chart(profile, view, name, seen_from) for name in view.arms for seen_from in _AXES)


def view_chart(profile: Profile, view: ViewResult, name: str, seen_from: SeenFrom = "above") -> Chart:
    """Show the shares of one arm's configurations that the tracker can measure.

    From above each mark is a column of cubes in the cell frame C [m]; from the tracker it is a square of directions,
    azimuth and elevation [deg], as large as a cube at the arm's base. The marks are ``SHADES``.
    """
    arm, style = view.arms[name], list(view.arms).index(name)
    title, axes = f"Arm {name}: what the tracker sees, {_TITLES[seen_from]}", _AXES[seen_from]
    pose, base = profile.tracker.pose, profile.arms[name].base
    if pose is None or base is None or not arm.cells:
        message = "No map: the profile does not say where base and tracker are (arms.*.base, tracker.pose)."
        return Chart(title, *axes, (), message)
    T_C_M, p_C = pose_matrix(pose), np.array([cube.centre_C for cube in arm.cells])
    at_base = np.array([base.position])
    if seen_from == "above":
        flat, base_at, size = p_C[:, :2], at_base[:, :2], arm.edge_m
    else:
        flat, base_at = _directions(p_C, T_C_M), _directions(at_base, T_C_M)
        size = math.degrees(arm.edge_m / float(np.linalg.norm(at_base - T_C_M[:3, 3])))
    points, share = _gathered(flat, arm, size)
    drawn = [*_shaded(points, share, style), _points("base", base_at, _OTHER_STYLE, "B")]
    if seen_from == "above":
        drawn.append(_points("tracker", T_C_M[np.newaxis, :2, 3], _OTHER_STYLE, "T"))
    message = _message(name, arm, points, share, seen_from)
    return Chart(title, *axes, tuple(drawn), message, equal=seen_from == "above")


def _points(name: str, points: Array, style: int, mark: str) -> Series:
    return series(name, points[:, 0], points[:, 1], "points", style=style, mark=mark)


def _directions(p_C: Array, T_C_M: Array) -> Array:
    """Compute azimuth and elevation (n, 2) [deg], seen from the tracker, of points (n, 3) in the cell frame C [m]."""
    x, y, z = apply(invert(T_C_M), p_C).T
    return np.asarray(np.degrees(np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=1)))


def _gathered(flat: Array, arm: ArmView, size: float) -> tuple[Array, Array]:
    """Return centres (k, 2) of squares of ``size``, and the share of the configurations in each that are seen."""
    squares, which = np.unique(np.floor(flat / size), axis=0, return_inverse=True)
    reachable = np.bincount(which.ravel(), [cube.reachable for cube in arm.cells])
    seen = np.bincount(which.ravel(), [cube.seen for cube in arm.cells])
    return size * (squares + 0.5), np.asarray(seen / np.maximum(reachable, FEW_CONFIGURATIONS))


def _shaded(points: Array, share: Array, style: int) -> Iterator[Series]:
    """Yield one series for each shade that occurs."""
    quarters = len(SHADES) - 1
    largest = max(float(share.max()), 1e-12)
    level = np.ceil(quarters * share / largest - 1e-9).astype(np.intp)
    for number, mark in enumerate(SHADES):
        rows = level == number
        if rows.any():
            limits = [100.0 * largest * max(step, 0) / quarters for step in (number - 1, number)]
            name = f"{limits[0]:.1f} to {limits[1]:.1f} % measurable" if number else "not measurable"
            yield _points(name, points[rows], style, mark)


def _message(name: str, arm: ArmView, points: Array, share: Array, seen_from: SeenFrom) -> str:
    best, x_y = int(np.argmax(share)), "xy" if seen_from == "above" else ("azimuth", "elevation")
    unit = "m" if seen_from == "above" else "deg"
    where = f"{x_y[0]} {points[best, 0]:.4g} {unit}, {x_y[1]} {points[best, 1]:.4g} {unit}"
    what = f"columns of {1e3 * arm.edge_m:.0f} mm" if seen_from == "above" else "directions"
    if not share.any():
        return f"Arm {name}: the tracker can measure nothing in any of {len(share)} {what}."
    return (
        f"Arm {name}: the tracker can measure the SMR in {np.count_nonzero(share)} of {len(share)} {what}; most often,"
        f" in {100.0 * share[best]:.1f} % of configurations, at {where}. Darker is more often."
    )
