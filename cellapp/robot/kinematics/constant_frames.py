"""Constant matrices and vectors of a chain's parameters: the base in the tracker frame, and the D-H rows.

Angles and lengths are those of ``robot.kinematics.chain``.
"""

from __future__ import annotations

import math

import numpy as np

from cellapp.robot.kinematics.transforms import Array

IN_TRACKER_AXES: Array = np.eye(3)
"""``R_ref`` of an arm whose first axis is near the tracker's z axis."""


def base_frame(base: Array, reference: Array) -> Array:
    """Vectors of the base in the tracker frame, shape (8, 3), from its parameters (6,) and ``R_ref`` (3, 3).

    x, y, z axes and origin of the base; then what does not rotate with theta0: x and y axes of the reference frame, the
    y axis after rot_x(alpha0), and the point (x0, y0, 0).
    """
    x0, y0, z0, alpha0, beta0, theta0 = base.tolist()
    ca, sa, cb, sb = math.cos(alpha0), math.sin(alpha0), math.cos(beta0), math.sin(beta0)
    ct, st = math.cos(theta0), math.sin(theta0)
    x, y, z = (cb, sa * sb, -ca * sb), (0.0, ca, sa), (sb, -sa * cb, ca * cb)
    vectors = np.array(
        [
            [ct * u + st * v for u, v in zip(x, y, strict=True)],
            [ct * v - st * u for u, v in zip(x, y, strict=True)],
            z,
            (x0 + z0 * z[0], y0 + z0 * z[1], z0 * z[2]),
            (1.0, 0.0, 0.0),
            (0.0, 1.0, 0.0),
            y,
            (x0, y0, 0.0),
        ]
    )
    return vectors if reference is IN_TRACKER_AXES else vectors @ reference.T


def row_matrices(rows: Array) -> Array:
    """Matrices (N, 4, 4) of D-H rows (N, 5) that map (x, y, z axis, origin) after rot_z(q_i) to those after A_i."""
    _, d, a, _, _ = rows.T
    angles = rows.T[[0, 3, 4]]  # theta, alpha, beta
    (ct, ca, cb), (st, sa, sb) = np.cos(angles), np.sin(angles)
    M = np.zeros((len(rows), 4, 4))
    M[:, 0, 0], M[:, 0, 1], M[:, 0, 2] = cb * ct - sb * sa * st, cb * st + sb * sa * ct, -sb * ca
    M[:, 1, 0], M[:, 1, 1], M[:, 1, 2] = -ca * st, ca * ct, sa
    M[:, 2, 0], M[:, 2, 1], M[:, 2, 2] = sb * ct + cb * sa * st, sb * st - cb * sa * ct, cb * ca
    M[:, 3, 0], M[:, 3, 1], M[:, 3, 2], M[:, 3, 3] = a * ct, a * st, d, 1.0
    return M
