"""Readings with gross errors: a broken beam, a wrong SMR, a disturbed arm. They are left out and said.

A reading is taken as grossly wrong where what a model leaves of it is longer than ``_MOST`` times a typical length; the
median of the lengths is not moved by a few of them. Noise with heavy tails, or a local error of an arm, stays below.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellapp.calibration.identification import identify
from cellapp.calibration.weights import MEDIAN_NORM
from cellapp.kinematics.chain import smr_positions
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel

_MOST = 10.0
"""Length over that of one standard deviation of a coordinate. Of Student's t with 4 degrees of freedom one reading in
several thousand is beyond; of a normal distribution none."""
_LEAST_M = 5e-5
"""Lengths below this are no gross errors [m], however small the typical one."""
_LEAST_READINGS = 40
"""Readings from which they are judged: with fewer, some 30 parameters of geometry leave residuals of most readings far
below the noise, and an effect that the model lacks looks like a gross error."""
_LARGEST_SHARE = 0.05
"""Share of readings beyond which long residuals are no gross errors but an effect that acts on some stops only."""
ROUNDS = 3
"""Searches at most: gross errors that a first one hid show in the next."""


def gross_errors(left_M: Array) -> NDArray[np.bool_]:
    """Which of the residuals (n, 3) [m] are gross errors; none where there are few."""
    lengths = np.linalg.norm(left_M, axis=1)
    if len(lengths) < _LEAST_READINGS:
        return np.zeros(len(lengths), dtype=np.bool_)
    wrong = np.asarray(lengths > max(_MOST * float(np.median(lengths)) / MEDIAN_NORM, _LEAST_M))
    return wrong if wrong.mean() <= _LARGEST_SHARE else np.zeros_like(wrong)


def gross_errors_of_geometry(model: ArmModel, q: Array, p_M: Array) -> NDArray[np.bool_]:
    """Which readings (n,) are gross errors for a geometry that gives such readings no weight.

    Parameters
    ----------
    model : ArmModel
        Where the identification begins.
    q : array, shape (n, N) [rad]
    p_M : array, shape (n, 3) [m]
    """
    if len(q) < _LEAST_READINGS:
        return np.zeros(len(q), dtype=np.bool_)
    found = identify(model.geometry, q, p_M, prior_mean=model.nominal, robust="tukey", tolerance=1e-6)
    return gross_errors(p_M - smr_positions(found.geometry, q))
