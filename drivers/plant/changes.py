"""Changes of a true mechanism between two days, as by a collision, a repair or a slipping encoder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.plant.config import Array
from drivers.plant.mechanism import Mechanism
from drivers.plant.transforms import inverse, rigid, transform_points


def zero_shifted(mechanism: Mechanism, joint: int, angle: float) -> Mechanism:
    """Return the mechanism whose ``joint`` (from 0) is truly ``angle`` [rad] further at the same reading."""
    zeros = mechanism.zeros.copy()
    zeros[joint] += angle
    return replace(mechanism, zeros=zeros)


def lengthened(mechanism: Mechanism, joint: int, length: float) -> Mechanism:
    """Return the mechanism with everything that ``joint`` (from 0) moves shifted along its axis by ``length`` [m]."""
    return _beyond(mechanism, joint, rigid(np.concatenate([length * mechanism.directions[joint], np.zeros(3)])))


def link_moved(mechanism: Mechanism, joint: int, twist: Array) -> Mechanism:
    """Return the mechanism with all beyond link ``joint`` (from 0) moved by a twist (6,) in its D-H frame [m, rad]."""
    frame = mechanism.frames[joint + 1]
    return _beyond(mechanism, joint, frame @ rigid(twist) @ inverse(frame))


def _beyond(mechanism: Mechanism, joint: int, motion: Array) -> Mechanism:
    """Return the mechanism with everything after ``joint`` moved by ``motion`` (4, 4) in B, at the zero position."""
    points, directions = mechanism.points.copy(), mechanism.directions.copy()
    centers, frames = mechanism.centers.copy(), mechanism.frames.copy()
    points[joint + 1 :] = transform_points(motion, points[joint + 1 :])
    directions[joint + 1 :] = directions[joint + 1 :] @ motion[:3, :3].T
    centers[joint:] = transform_points(motion, centers[joint:])
    frames[joint + 1 :] = motion @ frames[joint + 1 :]
    return replace(mechanism, points=points, directions=directions, centers=centers, frames=frames)
