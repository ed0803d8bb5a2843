"""Noise of positions and of orientations, from the uncertainties that weigh the readings."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.posterior import ReadingsNoise

_ALIKE_AXES = 0.01
"""Relative spread of an orientation's noise over its axes from which it is stated axis by axis."""


def readings_noise(sigma: Array, turned: NDArray[np.bool_] | None, scale: float = 1.0) -> ReadingsNoise:
    """Compute the rms noise, times ``scale``, of readings with uncertainties ``sigma`` (n,) or covariances (n, 3, 3);
    ``turned`` (n,) masks orientations."""
    if turned is None:
        return ReadingsNoise(math.sqrt(mean_variance(sigma)) * scale)
    m, rad = (math.sqrt(mean_variance(own)) * scale for own in (sigma[~turned], sigma[turned]))
    if sigma.ndim == 1:
        return ReadingsNoise(m, rad)
    axes_rad = np.sqrt(np.linalg.eigvalsh(sigma[turned]).mean(axis=0)) * scale
    return ReadingsNoise(m, rad, None if np.ptp(axes_rad) <= _ALIKE_AXES * axes_rad[-1] else axes_rad)


def mean_variance(sigma: Array) -> float:
    """Compute the mean variance of a coordinate [m^2] from standard uncertainties (n,) or covariances (n, 3, 3)."""
    if sigma.ndim == 1:
        return float(np.mean(sigma**2))
    return float(np.mean(np.trace(sigma, axis1=1, axis2=2))) / 3.0
