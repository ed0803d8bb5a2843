"""The noise of readings, of positions and of orientations, by the uncertainties that weigh them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.posterior import ReadingsNoise

_ALIKE_AXES = 0.01
"""Share by which the noise of orientations about its axes differs before it is stated axis by axis."""


def readings_noise(sigma: Array, turned: NDArray[np.bool_] | None, scale: float = 1.0) -> ReadingsNoise:
    """Root mean square noise, times a scale, of readings with uncertainties ``sigma`` (n,) or covariances (n, 3, 3), of
    which ``turned`` (n,) are orientations."""
    if turned is None:
        return ReadingsNoise(math.sqrt(mean_variance(sigma)) * scale)
    m, rad = (math.sqrt(mean_variance(own)) * scale for own in (sigma[~turned], sigma[turned]))
    if sigma.ndim == 1:
        return ReadingsNoise(m, rad)
    axes_rad = np.sqrt(np.linalg.eigvalsh(sigma[turned]).mean(axis=0)) * scale
    return ReadingsNoise(m, rad, None if np.ptp(axes_rad) <= _ALIKE_AXES * axes_rad[-1] else axes_rad)


def mean_variance(sigma: Array) -> float:
    """Mean variance of a coordinate [m^2] of standard uncertainties (n,) or covariances (n, 3, 3)."""
    if sigma.ndim == 1:
        return float(np.mean(sigma**2))
    return float(np.mean(np.trace(sigma, axis1=1, axis2=2))) / 3.0
