"""Selection of readings to draw, and the frame in which a cell is drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array


def evenly_spread(n: int, most: int) -> NDArray[np.intp]:
    """Return at most ``most`` of n row indices, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.intp))


def levelling_rotation(up_M: Array) -> Array:
    """Return the smallest rotation (3, 3) that maps ``up_M`` to z (Rodrigues' formula with axis up_M x z)."""
    x, y, z = up_M
    if z < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    skew = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + z))
