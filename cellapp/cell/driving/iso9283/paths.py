"""The test paths of ISO 9283 (6.8): the diagonal P2 to P4 and a circle about P1 in the plane of the poses.

The norm's other shapes (rectangle with and without rounded corners) are not driven.
"""

from __future__ import annotations

import numpy as np

from cellapp.cell.driving.iso9283.chosen_cube import ChosenCube
from cellapp.cell.targets.path_file import PathPose, PathSpec
from cellapp.estimation.iso9283.cube import circle_positions
from cellapp.robot.kinematics.transforms import Array, xyz_of, zyx_angles
from cellapp.robot.paths.cartesian import CartesianPath

PATH_SPEED = 0.25
"""Speed of the SMR along the paths at 100 % [m/s]: the norm's rated path velocity, which profiles do not state. It is
what collaborative arms may do beside people, and most joints keep it."""
_TOLERANCE_M = 1e-3
"""How far the joint path of the model may be from the commanded one; the plan itself stays below some 10 um."""
_PLACES = 50
"""Places along each path at which it is evaluated; the norm asks for ten or more."""
_ENDS = 0.02
"""Share of the path at each end that is left out: the arm is at rest there, and no plane is crossed."""


def path_specs(name: str, cube: ChosenCube, speed_share: float) -> list[PathSpec] | str:
    """The test paths of an arm in its base, or why it cannot drive them."""
    if not np.isfinite(cube.rotation_B).all():
        return "paths need an arm that can hold its rotation, with six joints or more"
    yaw, pitch, roll = zyx_angles(cube.rotation_B)
    rpy = (roll, pitch, yaw)
    at = cube.position_B
    circle = circle_positions({pose: at[pose] for pose in at if " " not in pose}, cube.edge)
    line = (PathPose(position=xyz_of(at["P2"]), rpy=rpy), PathPose(position=xyz_of(at["P4"])))
    arcs = (
        PathPose(position=xyz_of(circle[0]), rpy=rpy),
        PathPose(position=xyz_of(circle[2]), via=xyz_of(circle[1])),
        PathPose(position=xyz_of(circle[4]), via=xyz_of(circle[3])),
    )
    return [
        PathSpec(name=words, arm=name, tolerance=_TOLERANCE_M, speed=PATH_SPEED * speed_share, poses=poses)
        for words, poses in (("line P2 to P4", line), ("circle", arcs))
    ]


def places_along(path: CartesianPath) -> tuple[Array, Array]:
    """Places (m, 3) [m] on a path at which it is evaluated, and its unit tangents (m, 3) there."""
    s = path.length * np.linspace(_ENDS, 1.0 - _ENDS, _PLACES)
    half = 1e-4 * path.length
    chord = path.positions(s + half) - path.positions(s - half)
    return path.positions(s), chord / np.linalg.norm(chord, axis=1, keepdims=True)
