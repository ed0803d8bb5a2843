"""Dominant cycles per revolution of periodic joint errors, from the power of their Fourier coefficients."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cellapp.estimation.discovery.records import CycleBand
from cellapp.robot.effects import EffectColumn
from cellapp.robot.kinematics.transforms import Array

_BAND = (0.1, 0.9)
"""Shares of the cumulative power that bound the dominant cycles: the middle 80 %."""


def dominant_cycles(
    columns: Sequence[EffectColumn], values: Array, covariance: Array | None = None
) -> dict[str, CycleBand]:
    """Return the dominant cycles per revolution by joint (key: its number), from wave columns with values (m,) [rad].

    ``covariance`` (m, m) of the values gives the standard error of each joint's rms.
    """
    power: dict[int, dict[int, float]] = {}
    for column, value in zip(columns, values.tolist(), strict=True):
        if column.cycles is not None and column.joint is not None:
            of_joint = power.setdefault(column.joint, {})
            of_joint[column.cycles] = of_joint.get(column.cycles, 0.0) + 0.5 * value**2
    found = {str(joint + 1): _band(power[joint]) for joint in sorted(power) if any(power[joint].values())}
    if covariance is None:
        return found
    return {joint: _with_error(band, int(joint) - 1, columns, values, covariance) for joint, band in found.items()}


def _with_error(
    band: CycleBand, joint: int, columns: Sequence[EffectColumn], values: Array, covariance: Array
) -> CycleBand:
    """Add to the band the standard error of its rms; rms^2 is half the sum of the squared coefficients."""
    own = np.array([column.cycles is not None and column.joint == joint for column in columns])
    gradient = np.where(own, values, 0.0) / (2e-6 * band.rms_urad)
    error = math.sqrt(max(float(gradient @ covariance @ gradient), 0.0))
    return band.model_copy(update={"rms_standard_error_urad": error * 1e6})


def _band(power: dict[int, float]) -> CycleBand:
    counts = sorted(power)
    each = np.array([power[count] for count in counts])
    share = np.cumsum(each) / each.sum()
    first, last = (counts[min(int(np.searchsorted(share, at)), len(counts) - 1)] for at in _BAND)
    rms = float(np.sqrt(each.sum()))
    return CycleBand(first=first, last=last, peak=counts[int(np.argmax(each))], rms_urad=rms * 1e6)
