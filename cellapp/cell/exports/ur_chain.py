"""Common code of the exports for Universal Robots: check that an arm has UR's chain, and return its calibrated rows."""

from __future__ import annotations

import numpy as np

from cellapp.cell.exports.arm_export import ArmExport
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.plain_dh import plain_geometry
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import published_rows

_ALPHA = np.radians([90.0, 0.0, 0.0, 90.0, -90.0, 0.0])
_A, _D = [1, 2], [0, 3, 4, 5]
"""Rows with a length a, or d. Source: Universal Robots, "DH Parameters for calculations of kinematics and dynamics"."""
_ROUNDING = 1e-6
"""Tolerance [m, rad] for rounded right angles in a published table: UR's own states 1.570796327."""


def ur_rows(export: ArmExport) -> Array:
    """Return the calibrated plain D-H rows (6, 4) for the controller: theta, d, a, alpha [rad, m].

    Raises
    ------
    InputError
        If the arm's published table is not that of a UR arm.
    """
    rows = published_rows(export.arm)
    if len(rows) == len(_ALPHA):
        expected = np.zeros((6, 4))
        expected[_D, 1], expected[_A, 2], expected[:, 3] = rows[_D, 1], rows[_A, 2], _ALPHA
    if len(rows) != len(_ALPHA) or not np.allclose(rows, expected, rtol=0.0, atol=_ROUNDING):
        raise InputError(
            f"export: arm '{export.name}' ({export.arm.type.model}) does not have the chain of a UR arm: six joints,"
            " alpha 90, 0, 0, 90, -90, 0 degrees; nothing was written. Take urdf, dh, dh-plain or poe, or give --arm"
        )
    return np.asarray(plain_geometry(export.geometry).rows[:, :4])
