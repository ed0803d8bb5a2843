"""Formulas of ISO 9283:1998 for positions, and their counterparts for two arms.

Attained positions are arrays (..., n, 3) [m]: n cycles on the last axis but one. Every function is vectorised over the
leading axes, so that the same formula serves measured and simulated cycles. The standard's characteristics of
orientation need three points on the flange; one SMR gives none of them.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import stdtrit

from cellapp.robot.kinematics.transforms import Array

FEWEST_CYCLES = 2
"""Least number of cycles: a standard deviation needs two values."""
_PROBABILITY = 0.97725
"""One-sided probability of an expanded uncertainty with the coverage factor 2."""


def coverage_of_mean(n: int) -> float:
    """Compute the ratio of a mean's expanded uncertainty to its n values' standard deviation: Student's t / sqrt(n)."""
    return float(stdtrit(n - 1, _PROBABILITY)) / math.sqrt(n)


def accuracy_vector(attained: Array, commanded: Array) -> Array:
    """Compute mean attained minus commanded position (..., 3): AP_x, AP_y, AP_z (7.2.1)."""
    return np.asarray(attained.mean(axis=-2) - commanded)


def pose_accuracy(attained: Array, commanded: Array) -> Array:
    """Compute AP (7.2.1), shape (...): distance of the mean attained position from the commanded one (..., 3)."""
    return np.asarray(np.linalg.norm(accuracy_vector(attained, commanded), axis=-1))


def pose_repeatability(attained: Array) -> Array:
    """Compute RP (7.2.2), shape (...): ``mean(l) + 3 S_l`` of the distances l of attained positions from their mean.

    Raise ``ValueError`` for fewer than two cycles.
    """
    centre = attained.mean(axis=-2, keepdims=True)
    return _upper_limit(np.linalg.norm(attained - centre, axis=-1))


def directional_variation(attained: Array) -> Array:
    """Compute vAP (7.2.3), shape (...): largest distance between mean positions of k directions (..., k, n, 3)."""
    means = attained.mean(axis=-2)
    return np.asarray(np.linalg.norm(means[..., :, None, :] - means[..., None, :, :], axis=-1).max(axis=(-2, -1)))


def distances(first: Array, second: Array) -> Array:
    """Compute the distance (..., n) between two attained positions of each cycle."""
    return np.asarray(np.linalg.norm(second - first, axis=-1))


def distance_accuracy(first: Array, second: Array, commanded: Array | float) -> Array:
    """Compute AD (7.3.2), shape (...): mean attained distance minus the commanded one."""
    return np.asarray(distances(first, second).mean(axis=-1) - commanded)


def distance_repeatability(first: Array, second: Array) -> Array:
    """Compute RD (7.3.3), shape (...): three standard deviations of the attained distance.

    Raise ``ValueError`` for fewer than two cycles.
    """
    found = distances(first, second)
    _require_cycles(found)
    return np.asarray(3.0 * found.std(axis=-1, ddof=1))


def drift(values: Array) -> Array:
    """Compute dAP or dRP (7.6), shape (...): largest change of AP or RP of k groups (..., k) from the first one."""
    return np.asarray(np.abs(values - values[..., :1]).max(axis=-1))


def path_accuracy(attained: Array, commanded: Array) -> Array:
    """Compute AT (8.2), shape (...): largest distance, over m points, of the mean path from ``commanded`` (m, 3), with
    ``attained`` (..., m, n, 3)."""
    return np.asarray(pose_accuracy(attained, commanded).max(axis=-1))


def path_repeatability(attained: Array) -> Array:
    """Compute RT (8.3), shape (...): largest ``mean(l) + 3 S_l`` over m points (..., m, n, 3)."""
    return np.asarray(pose_repeatability(attained).max(axis=-1))


def plane_crossings(points: Array, commanded: Array, tangents: Array, within_m: float) -> Array:
    """Compute where an attained path crosses the planes normal to the commanded one, (m, c); NaN where it does not.

    Parameters
    ----------
    points : array, shape (k, c)
        Attained path in order: position [m], straight between the points, and other values that change along it, such
        as time.
    commanded, tangents : arrays, shape (m, 3)
        Points on the commanded path [m], and its unit tangents there: normals of the planes.
    within_m : float
        Largest distance of a crossing from its point [m]; farther ones belong to another part of the path, as on a
        closed curve.
    """
    found = np.full((len(commanded), points.shape[1]), np.nan)
    heights = np.einsum("kma,ma->km", points[:, None, :3] - commanded, tangents)
    for m in range(len(commanded)):
        k = np.flatnonzero((heights[:-1, m] <= 0.0) & (heights[1:, m] > 0.0))
        share = heights[k, m] / (heights[k, m] - heights[k + 1, m])
        crossing = points[k] + share[:, None] * (points[k + 1] - points[k])
        off = np.linalg.norm(crossing[:, :3] - commanded[m], axis=1)
        if len(k) and off.min() <= within_m:
            found[m] = crossing[np.argmin(off)]
    return found


def speeds(times: Array, s: Array) -> Array:
    """Compute speeds (n, m - 1) [m/s] between points at arc lengths ``s`` (m,) [m] passed at ``times`` (n, m) [s]."""
    return np.asarray(np.diff(s) / np.diff(times, axis=-1))


def velocity_accuracy(found: Array, commanded: float) -> float:
    """Compute AV (8.6.2) [1]: mean of the speeds (n, k) [m/s] minus the commanded speed, as a share of it.

    The standard's text was not at hand; the formulas of velocities are those commonly given.
    """
    return float(found.mean(axis=-1).mean() / commanded - 1.0)


def velocity_repeatability(found: Array, commanded: float) -> float:
    """Compute RV (8.6.3) [1]: three standard deviations of the cycles' mean speeds, as a share of ``commanded``.

    The speeds ``found`` are (n, k) [m/s]. Raise ``ValueError`` for fewer than two cycles.
    """
    means = found.mean(axis=-1)
    _require_cycles(means)
    return float(3.0 * means.std(ddof=1) / commanded)


def velocity_fluctuation(found: Array) -> float:
    """Compute FV (8.6.4) [m/s]: the largest difference of two speeds (n, k) [m/s] within a cycle, over all cycles."""
    return float(np.ptp(found, axis=-1).max())


def _upper_limit(lengths: Array) -> Array:
    _require_cycles(lengths)
    return np.asarray(lengths.mean(axis=-1) + 3.0 * lengths.std(axis=-1, ddof=1))


def _require_cycles(values: Array) -> None:
    if values.shape[-1] < FEWEST_CYCLES:
        raise ValueError(f"a repeatability needs at least {FEWEST_CYCLES} cycles, not {values.shape[-1]}")
