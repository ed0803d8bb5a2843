"""Whether a target is met to its tolerance: predicted from the model's uncertainty, or measured."""

from __future__ import annotations

from cellapp.results import ToleranceVerdict

_HIGH = 3.395
"""Length [standard deviations of a coordinate] below which the error is with 95 % probability, in whatever directions:
sqrt(3) 1.960, of an error along one line. No other normal error of the same mean square reaches further with 5 %
probability (Szekely, Bakirov: Extremal probabilities for Gaussian quadratic forms, 2003)."""
_LOW = 0.593
"""Length above which it is with 95 % probability if it is alike in all directions: the root of the 5th percentile of
the chi-squared distribution with three degrees of freedom, 0.352."""


def predicted_verdict(uncertainty_mm: float | None, tolerance_mm: float | None) -> ToleranceVerdict:
    """Judge a compensated command before it is driven.

    The model expects the SMR at the target, so the error is a normal vector about zero; ``uncertainty_mm`` is the root
    mean square of the standard deviations of its three coordinates. "in": with 95 % probability the error is within
    ``tolerance_mm``, 3.395 standard deviations or more; "out": with 95 % probability it is beyond, as 0.593 standard
    deviations are; "cannot say": neither, or the model states no uncertainty (None). Empty without a tolerance.
    What the model lacks is no part of its uncertainty: only a measurement settles it.
    """
    if tolerance_mm is None:
        return ""
    if uncertainty_mm is None:
        return "cannot say"
    if _HIGH * uncertainty_mm <= tolerance_mm:
        return "in"
    return "out" if _LOW * uncertainty_mm > tolerance_mm else "cannot say"


def measured_verdict(error_mm: float | None, tolerance_mm: float | None) -> ToleranceVerdict:
    """Judge the distance [mm] of the measured SMR from its target. Empty without a tolerance or a measurement."""
    if error_mm is None or tolerance_mm is None:
        return ""
    return "in" if error_mm <= tolerance_mm else "out"
