"""Predict whether a target will be met within its tolerance, from the model's uncertainty.

An error x is a normal vector with zero mean and covariance C. Its squared length is a sum of squares weighted with the
eigenvalues of C, so that all of its cumulants follow from traces:

    k1 = tr C,  k2 = 2 tr C^2,  k3 = 8 tr C^3.

The upper quantile is that of a shifted gamma distribution with these three cumulants (Hall, Buckley, Eagleson: Buckley,
Eagleson, Australian J. Statist. 30A (1988) 150). It is exact if all non-zero weights are equal; for any weights its 95
% quantile is exceeded with 4.7 to 5.0 % probability. The lower quantile is that of a gamma distribution with two
cumulants (Satterthwaite 1946), because the shift is too coarse there; it is at most the true quantile.
"""

from __future__ import annotations

import numpy as np
import scipy

from cellapp.estimation.uncertainty.decision import TARGET_WORDS, decided
from cellapp.estimation.uncertainty.records import ToleranceVerdict
from cellapp.robot.kinematics.transforms import Array

LIKELY = 0.95
"""Probability of all statements about tolerances."""


def length_bounds(covariance: Array) -> tuple[Array, Array]:
    """Return the lengths (n,) that normal vectors exceed, and those that they stay within, with 95 % probability.

    ``covariance`` (n, 3, 3) and the lengths have the same unit of length. Zero for zero covariance.
    """
    squared = covariance @ covariance
    k1 = np.trace(covariance, axis1=1, axis2=2)
    k2 = 2.0 * np.trace(squared, axis1=1, axis2=2)
    k3 = 8.0 * np.einsum("nij,nji->n", squared, covariance)
    some = k1 > 0.0
    k1, k2, k3 = (np.where(some, k, 1.0) for k in (k1, k2, k3))
    freedom = 8.0 * k2**3 / k3**2
    high = k1 + np.sqrt(0.5 * k2 / freedom) * (2.0 * scipy.special.gammaincinv(0.5 * freedom, LIKELY) - freedom)
    low = 0.5 * k2 / k1 * 2.0 * scipy.special.gammaincinv(k1**2 / k2, 1.0 - LIKELY)
    return np.sqrt(np.where(some, low, 0.0)), np.sqrt(np.where(some, high, 0.0))


def predicted_verdict(low_mm: float, high_mm: float, tolerance_mm: float | None) -> ToleranceVerdict:
    """Judge a compensated command before it is driven, by the common decision rule, guarded.

    The model expects the SMR at the target. ``low_mm`` and ``high_mm`` are ``length_bounds``: of the SMR's error, and
    of the error that a measurement finds. "in": with 95 % probability the error is within ``tolerance_mm``; "out": with
    95 % probability it is larger; "cannot say": neither. Empty without a tolerance. Deficiencies of the model are not
    part of its uncertainty: only a measurement reveals them.
    """
    return "" if tolerance_mm is None else TARGET_WORDS[decided(low_mm, high_mm, tolerance_mm)]
