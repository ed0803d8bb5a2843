"""Convert a chain to origins of joints that rotate about their own z axes, as in URDF."""

from __future__ import annotations

import numpy as np

from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array, rotation_x, rotation_y, rotation_z, transform


def joint_origins(geometry: Geometry) -> Array:
    """Return poses (N + 1, 4, 4): each joint in the frame of the joint before (first the base), then the flange.

    The base frame times ``origin_1 rot_z(q_1) ... origin_N rot_z(q_N) origin_flange`` is the flange. Theta and d of a
    D-H row commute with the rotation of its joint and are applied before it; a, alpha and beta before the next joint.
    This is exact for every row. UR's ``ur_description`` splits the rows in the same way.
    """
    before = np.array([transform(rotation_z(theta), [0.0, 0.0, d]) for theta, d in geometry.rows[:, :2]])
    behind = dh_frames_in_links(geometry)
    return np.array([before[0], *(behind[:-1] @ before[1:]), behind[-1]])


def dh_frames_in_links(geometry: Geometry) -> Array:
    """Return the poses (N, 4, 4) of D-H frame i in the frame of the link that joint i rotates."""
    return np.array(
        [transform(rotation_x(alpha) @ rotation_y(beta), [a, 0.0, 0.0]) for a, alpha, beta in geometry.rows[:, 2:]]
    )
