"""The test paths of ISO 9283 (6.8): the diagonal P2 to P4, and circles in the plane of the poses."""

from __future__ import annotations

import numpy as np

from cellapp.cell.driving.iso9283.chosen_cube import ChosenCube
from cellapp.cell.targets.path_file import PathPose, PathSpec
from cellapp.estimation.iso9283.cube import LARGE_CIRCLE, SMALL_CIRCLE, circle_positions
from cellapp.robot.kinematics.transforms import Array, rpy_of, xyz_of
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


def path_specs(name: str, cube: ChosenCube, speed_share: float) -> list[PathSpec] | str:
    """Return the test paths of an arm in its base, or why it cannot drive them."""
    if not np.isfinite(cube.rotation_B).all():
        return "paths need an arm that can hold its rotation, with six joints or more"
    rpy = rpy_of(cube.rotation_B)
    at = cube.position_B
    shapes = {
        "line P2 to P4": (PathPose(position=xyz_of(at["P2"]), rpy=rpy), PathPose(position=xyz_of(at["P4"]))),
        "large circle": _round(circle_positions(at, cube.edge, LARGE_CIRCLE), rpy),
        "small circle": _round(circle_positions(at, cube.edge, SMALL_CIRCLE), rpy),
    }
    return [
        PathSpec(name=words, arm=name, tolerance=_TOLERANCE_M, speed=PATH_SPEED * speed_share, poses=poses)
        for words, poses in shapes.items()
    ]


def places_along(path: CartesianPath) -> tuple[Array, Array, Array]:
    """Return arc lengths (m,) [m], positions (m, 3) [m] and unit tangents (m, 3) where a path is evaluated."""
    s = path.length * np.linspace(_ENDS, 1.0 - _ENDS, _PLACES)
    half = 1e-4 * path.length
    chord = path.positions(s + half) - path.positions(s - half)
    return s, path.positions(s), chord / np.linalg.norm(chord, axis=1, keepdims=True)


# -- inside -----------------------------------------------------------------------------------------------------------


def _round(points: Array, rpy: tuple[float, float, float]) -> tuple[PathPose, ...]:
    return (
        PathPose(position=xyz_of(points[0]), rpy=rpy),
        PathPose(position=xyz_of(points[2]), via=xyz_of(points[1])),
        PathPose(position=xyz_of(points[4]), via=xyz_of(points[3])),
    )
