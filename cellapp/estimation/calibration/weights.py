"""Weights of readings: stated uncertainty, robust estimation, and scatter beyond the stated uncertainty."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.model import ReadingsNoise

RobustName = Literal["none", "huber", "tukey"]

_HUBER = 2.5003
"""Norm beyond which Huber's weight falls: root of the 90 % quantile of chi-square with 3 degrees of freedom."""
_TUKEY = 6.0
"""Norm beyond which Tukey's weight is zero: about four times the median norm of a good point."""
MEDIAN_NORM = 1.5382
"""Median of the norm of three independent standard normal variables."""
NORMAL_95 = 1.959964
"""Half width of the 95 % interval of a normal distribution, in standard deviations: its quantile 0.975."""
_CHANCE = 3.0
"""Standard deviations by which chi-square must exceed its degrees of freedom for the scatter to count as excess."""
_SETTLED, _MOST_STEPS = 1e-6, 100
"""Relative step at which an added variance is found, after three steps or so; steps below the root end there in any
case."""


def whitener(sigma: Array) -> Array:
    """Compute factors that convert errors of points into units of their standard uncertainty.

    Standard uncertainties (n,) [m] give (n,) [1/m]. Covariances (n, 3, 3) [m^2] give lower triangular (3, 3, n) [1/m].
    """
    if sigma.ndim == 1:
        return np.asarray(1.0 / sigma)
    return np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(sigma)).transpose(1, 2, 0))


def robust_weights(norm: Array, robust: Literal["huber", "tukey"]) -> Array:
    """Compute robust weights (n,) of whole points from the norms (n,) of their residuals, scaled by the median norm.

    Source: Huber, Robust Statistics (1981); Beaton, Tukey, Technometrics 16 (1974) 147 (biweight).
    """
    u = norm / max(float(np.median(norm)) / MEDIAN_NORM, 1e-300)
    if robust == "huber":
        return np.asarray(np.minimum(1.0, _HUBER / np.maximum(u, 1e-12)))
    return np.asarray(np.where(u < _TUKEY, (1.0 - (np.minimum(u, _TUKEY) / _TUKEY) ** 2) ** 2, 0.0))


def excess_variance(residuals: Array, sigma: Array, degrees_of_freedom: float) -> float:
    """Compute the variance [m^2] per coordinate that must be added to the stated one to explain the scatter.

    It is the root tau^2 of ``sum_i r_i^T (S_i + tau^2 I)^-1 r_i = degrees of freedom``, after DerSimonian, Laird,
    Control. Clin. Trials 7 (1986) 177; zero if the scatter is not larger than chance allows.

    Parameters
    ----------
    residuals : array, shape (n, 3)
        [m]
    sigma : array, shape (n,) [m] or (n, 3, 3) [m^2]
    degrees_of_freedom : float
    """
    if sigma.ndim == 1:
        variance, squares = sigma[:, None] ** 2, residuals**2
    else:
        variance, axes = np.linalg.eigh(sigma)
        squares = np.einsum("nab,na->nb", axes, residuals) ** 2

    chance = _CHANCE * math.sqrt(2.0 * degrees_of_freedom)  # chi-square has variance 2 f
    if float(np.sum(squares / variance)) - degrees_of_freedom <= chance:
        return 0.0
    return _added_variance(squares, variance, degrees_of_freedom)


def _added_variance(squares: Array, variance: Array, degrees_of_freedom: float) -> float:
    """Find v [m^2] with ``sum(squares / (variance + v)) = degrees_of_freedom``, at least 0.

    One over that sum is concave in v and nearly linear: Newton's steps for it from below end below the root.
    """
    v = 0.0
    for _ in range(_MOST_STEPS):
        inverse = 1.0 / (variance + v)
        total = float(np.sum(squares * inverse))
        if total <= degrees_of_freedom:
            break
        step = (total / degrees_of_freedom - 1.0) * total / float(np.sum(squares * inverse**2))
        v += step
        if step <= _SETTLED * v:
            break
    return v


def excess_of_kinds(
    residuals: Array, sigma: Array, degrees_of_freedom: float, turned: NDArray[np.bool_] | None, of_turns: float
) -> tuple[float, float]:
    """Compute ``excess_variance`` of positions [m^2] and of orientations [rad^2], each from its own scatter.

    ``of_turns`` are the degrees of freedom of the orientations, masked by ``turned`` (n,), a part of all.
    """
    if turned is None:
        return excess_variance(residuals, sigma, degrees_of_freedom), 0.0
    freedom = (max(degrees_of_freedom - of_turns, 1.0), max(of_turns, 1.0))
    found = [
        excess_variance(residuals[rows], sigma[rows], its)
        for rows, its in zip((~turned, turned), freedom, strict=True)
        if rows.any()
    ]
    return found[0], found[-1]


def with_excess(
    sigma: Array, tau_squared: float, turned: NDArray[np.bool_] | None = None, of_turns: float = 0.0
) -> Array:
    """Add an excess variance [m^2] per coordinate to the stated uncertainty, in the shape and unit of ``sigma``.

    ``of_turns`` [rad^2] is the excess variance of orientations, masked by ``turned`` (n,).
    """
    added = tau_squared if turned is None else np.where(turned, of_turns, tau_squared)
    if sigma.ndim == 1:
        return np.sqrt(sigma**2 + added)
    return np.asarray(sigma + np.multiply.outer(added, np.eye(3)))


# -- Noise of positions and of orientations, from the uncertainties that weigh the readings ---------------------------

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
