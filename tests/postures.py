"""Postures at which an arm moves alike in all directions: what is asked of targets that every test must reach."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.inverse import errors_and_jacobian
from cellapp.robot.kinematics.transforms import Array

_LEAST = 0.03
"""Smallest singular value of the Jacobian [m, rad a radian]: deviations of some milliradians turn no joint by more than
a tenth of a radian."""


def far_from_singular(geometry: Geometry, q: Array) -> NDArray[np.bool_]:
    """Whether configurations ``q`` (n, N) [rad] are far from singular ones, shape (n,)."""
    _, jacobian = errors_and_jacobian(geometry, np.zeros((len(q), 3)), np.tile(np.eye(3), (len(q), 1, 1)), q)
    return np.asarray(np.linalg.svd(jacobian, compute_uv=False)[:, -1] > _LEAST)
