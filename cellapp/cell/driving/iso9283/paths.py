"""The test paths of ISO 9283 (6.8): the diagonal P2 to P4, rectangles and circles in the plane of the poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.cell.driving.iso9283.chosen_cube import ChosenCube
from cellapp.cell.targets.path_file import PathPose, PathSpec
from cellapp.estimation.iso9283.along import Corner
from cellapp.estimation.iso9283.cube import (
    LARGE_CIRCLE,
    RECTANGLE_CORNERS,
    SMALL_CIRCLE,
    circle_positions,
    rectangle_positions,
)
from cellapp.estimation.iso9283.norm import REORIENTED_LINE
from cellapp.robot.kinematics.transforms import Array, rotation_zyx, rpy_of, xyz_of
from cellapp.robot.paths.cartesian import CartesianPath

PATH_SPEED = 0.25
"""Speed of the SMR along the paths at 100 % [m/s]. It stands for the standard's rated path velocity, which profiles do
not state: collaborative arms may move so fast beside people, and most joints can follow."""
_TOLERANCE_M = 1e-3
"""Allowed distance of the model's joint path from the commanded path [m]; the plan itself stays below some 10 um."""
_PLACES = 50
"""Number of positions along each path where it is evaluated; the standard requires at least ten."""
_ENDS = 0.02
"""Fraction of the path left out at each end: the arm is at rest there, and no plane is crossed."""
_BLEND_SHARE = 0.1
"""Length of the rounding before and after each corner, relative to the rectangle's shorter side."""
_REACH_SHARE = 0.4
"""Distance from a corner within which points belong to it, relative to the rectangle's shorter side."""

_REORIENTED_RAD = float(np.radians(20.0))
"""Rotation of the flange about its own axis along a line with reorientation [rad]."""
_WEAVING_SPEED = 0.05
"""Speed of the SMR along the zigzag at 100 % [m/s]: an arm that swings several times a second cuts its turns."""
_WAVES = 5
_WAVE_SHARE, _STROKE_SHARE = 0.08, 0.06
"""Length of a wave and its peak-to-peak height, relative to the cube's edge."""
_TURN_BLEND = 0.25
"""Length of the rounding at the turns of a zigzag, relative to its legs."""

LINE, RECTANGLE, ROUNDED = "line P2 to P4", "rectangle", "rectangle, rounded corners"
LARGE, SMALL, WEAVING = "large circle", "small circle", "weaving"


def path_specs(name: str, cube: ChosenCube, speed_share: float) -> list[PathSpec] | str:
    """Return the test paths of an arm in its base, or why it cannot drive them."""
    if not np.isfinite(cube.rotation_B).all():
        return "paths need an arm that can hold its rotation, with six joints or more"
    rpy = rpy_of(cube.rotation_B)
    at = {pose: p_B for pose, p_B in cube.position_B.items() if " " not in pose}
    sides = rectangle_positions(at)
    blend = _BLEND_SHARE * _shorter_side(sides)
    shapes = {
        LINE: _straight([at["P2"], at["P4"]], rpy),
        RECTANGLE: _straight(sides, rpy),
        ROUNDED: _straight(sides, rpy, blend),
        LARGE: _round(circle_positions(at, cube.edge, LARGE_CIRCLE), rpy),
        SMALL: _round(circle_positions(at, cube.edge, SMALL_CIRCLE), rpy),
        REORIENTED_LINE: _reoriented(at["P2"], at["P4"], cube.rotation_B),
    }
    return [
        PathSpec(name=words, arm=name, tolerance=_TOLERANCE_M, speed=PATH_SPEED * speed_share, poses=poses)
        for words, poses in shapes.items()
    ]


def weaving_spec(name: str, cube: ChosenCube, speed_share: float) -> PathSpec:
    """Return a line with weaving about P1 in the plane of the poses, from P2 towards P4."""
    along, across = weaving_axes(cube)
    half = 0.5 * _WAVE_SHARE * cube.edge
    legs = np.arange(2 * _WAVES + 1)
    points = (
        cube.position_B["P1"]
        + np.outer((legs - _WAVES) * half, along)
        + np.outer(0.5 * _STROKE_SHARE * cube.edge * np.where(legs % 2 == 1, 1.0, -1.0), across)
    )
    blend = _TURN_BLEND * float(np.hypot(half, _STROKE_SHARE * cube.edge))
    return PathSpec(
        name=WEAVING,
        arm=name,
        tolerance=_TOLERANCE_M,
        speed=_WEAVING_SPEED * speed_share,
        poses=_straight(points, rpy_of(cube.rotation_B), blend),
    )


def weaving_axes(cube: ChosenCube) -> tuple[Array, Array]:
    """Return unit vectors of the line and of the weaving in the arm's base; both lie in the plane of the poses."""
    at = cube.position_B
    along = at["P4"] - at["P2"]
    along = along / np.linalg.norm(along)
    across = at["P5"] - at["P3"]
    across = across - (across @ along) * along
    return along, across / np.linalg.norm(across)


def weaving_turns(cube: ChosenCube) -> Array:
    """Return the distance of each turn along the line from the start of the zigzag [m], without its ends."""
    return 0.5 * _WAVE_SHARE * cube.edge * np.arange(1.0, 2.0 * _WAVES)


def places_along(path: CartesianPath) -> tuple[Array, Array, Array]:
    """Return arc lengths (m,) [m], positions (m, 3) [m] and unit tangents (m, 3) where a path is evaluated."""
    s = path.length * np.linspace(_ENDS, 1.0 - _ENDS, _PLACES)
    half = 1e-4 * path.length
    chord = path.positions(s + half) - path.positions(s - half)
    return s, path.positions(s), chord / np.linalg.norm(chord, axis=1, keepdims=True)


def corners_of(spec: PathSpec, positions_M: Array) -> tuple[Corner, ...]:
    """Return the corners of a path through ``positions_M`` (k, 3) [m], its poses in order; none of a line or circle."""
    if spec.name not in (RECTANGLE, ROUNDED):
        return ()
    ways = np.diff(positions_M, axis=0)
    units = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    reach = _REACH_SHARE * _shorter_side(positions_M)
    return tuple(
        Corner(name, positions_M[k + 1], units[k], units[k + 1], reach) for k, name in enumerate(RECTANGLE_CORNERS)
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _shorter_side(sides: Array) -> float:
    """Return the shorter side [m] of a rectangle (6, 3) [m] that begins and ends in the middle of a side."""
    return float(np.linalg.norm(np.diff(sides[1:5], axis=0), axis=1).min())


def _straight(
    points: Sequence[Array] | Array, rpy: tuple[float, float, float], blend: float = 0.0
) -> tuple[PathPose, ...]:
    last = len(points) - 1
    return tuple(
        PathPose(position=xyz_of(point), rpy=rpy if k == 0 else None, blend=blend if 0 < k < last else 0.0)
        for k, point in enumerate(points)
    )


def _reoriented(start: Array, end: Array, rotation_B: Array) -> tuple[PathPose, ...]:
    turned = rotation_B @ rotation_zyx(_REORIENTED_RAD, 0.0, 0.0)
    poses = []
    for position, rotation in ((start, rotation_B), (end, turned)):
        poses.append(PathPose(position=xyz_of(position), rpy=rpy_of(rotation)))
    return tuple(poses)


def _round(points: Array, rpy: tuple[float, float, float]) -> tuple[PathPose, ...]:
    return (
        PathPose(position=xyz_of(points[0]), rpy=rpy),
        PathPose(position=xyz_of(points[2]), via=xyz_of(points[1])),
        PathPose(position=xyz_of(points[4]), via=xyz_of(points[3])),
    )
