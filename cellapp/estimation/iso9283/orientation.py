"""Accuracy and repeatability of orientation by ISO 9283:1998, 7.2.1 and 7.2.2, from a 6-D probe on the flange.

The standard takes differences of three angles between attained and commanded orientation. Here they are the components
of the rotation vector from the commanded to the attained orientation, about the axes of the arm's base. To first order
this is the same for rotations about these axes, and no choice of angles can be singular at the commanded orientation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cellapp.estimation.iso9283.characteristics import FEWEST_CYCLES, coverage_of_mean
from cellapp.estimation.iso9283.records import OrientationCharacteristics
from cellapp.robot.kinematics.transforms import Array, rotation_vectors, rotations_of, xyz_of

COVERAGE = 2.0
"""Coverage factor of expanded uncertainties."""


def orientation_characteristics(
    attained: Sequence[Array], commanded_M: Array, base_M: Array, sigma_rad: Sequence[float]
) -> OrientationCharacteristics | None:
    """Compute the characteristics of one pose; None with fewer than two cycles.

    Parameters
    ----------
    attained : sequence of n arrays, shape (4,)
        Measured orientations of the probe in the tracker frame, unit quaternions, scalar first.
    commanded_M : array, shape (3, 3)
        Commanded orientation of the probe in the tracker frame.
    base_M : array, shape (3, 3)
        Rotation of the base in the tracker frame.
    sigma_rad : sequence of n float
        Standard uncertainty of each orientation about each axis [rad]; for the uncertainty of the accuracy, all of it
        is taken as common to the cycles.
    """
    n = len(attained)
    if n < FEWEST_CYCLES:
        return None
    off = rotation_vectors(rotations_of(attained) @ commanded_M.T) @ base_M
    scatter = off.std(axis=0, ddof=1)
    largest = float(scatter.max())
    accuracy = math.hypot(coverage_of_mean(n) * largest, COVERAGE * float(np.mean(sigma_rad)))
    return OrientationCharacteristics(
        accuracy_mrad=xyz_of(1e3 * off.mean(axis=0)),
        accuracy_expanded_mrad=1e3 * accuracy,
        repeatability_mrad=xyz_of(3e3 * scatter),
        repeatability_expanded_mrad=COVERAGE * 3e3 * largest / math.sqrt(2.0 * (n - 1)),
        n=n,
        deviations_mrad=tuple(xyz_of(1e3 * one) for one in off),
    )
