"""Formulas of velocity characteristics and cornering deviations of a path that was driven in several cycles.

Clauses 8.5 and 8.6 of ISO 9283:1998. The standard's text was not at hand; its table of contents is public, and the
formulas are those commonly given for these characteristics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.estimation.iso9283.characteristics import FEWEST_CYCLES
from cellapp.robot.kinematics.transforms import Array


def speeds(times: Array, s: Array) -> Array:
    """Compute speeds (n, m - 1) [m/s] between points at arc lengths ``s`` (m,) [m] passed at ``times`` (n, m) [s]."""
    return np.asarray(np.diff(s) / np.diff(times, axis=-1))


def velocity_accuracy(found: Array, commanded: float) -> float:
    """Compute AV (8.6.2) [1]: mean of the speeds (n, k) [m/s] minus the commanded speed, as a share of it."""
    return float(found.mean(axis=-1).mean() / commanded - 1.0)


def velocity_repeatability(found: Array, commanded: float) -> float:
    """Compute RV (8.6.3) [1]: three standard deviations of the cycles' mean speeds, as a share of ``commanded``.

    The speeds ``found`` are (n, k) [m/s]. Raise ``ValueError`` for fewer than two cycles.
    """
    if len(found) < FEWEST_CYCLES:
        raise ValueError(f"a repeatability needs at least {FEWEST_CYCLES} cycles, not {len(found)}")
    return float(3.0 * found.mean(axis=-1).std(ddof=1) / commanded)


def velocity_fluctuation(found: Array) -> float:
    """Compute FV (8.6.4) [m/s]: the largest difference of two speeds (n, k) [m/s] within a cycle, over all cycles."""
    return float(np.ptp(found, axis=-1).max())


@dataclass(frozen=True, eq=False)
class Corner:
    """Corner of a commanded path.

    Attributes
    ----------
    name : str
    at_M : array, shape (3,)
        Position [m].
    before_M, after_M : arrays, shape (3,)
        Unit directions of the path before and after the corner.
    reach : float
        Distance from the corner up to which points belong to it [m].
    """

    name: str
    at_M: Array
    before_M: Array
    after_M: Array
    reach: float


def corner_rounding(points: Array, corner: Corner) -> float:
    """Compute CR of one cycle (8.5.2) [m]: smallest distance of the attained path (k, 3) [m] from a corner; NaN if that
    is above ``reach``."""
    start, way = points[:-1], np.diff(points, axis=0)
    length2 = np.maximum(np.einsum("ka,ka->k", way, way), 1e-24)
    share = np.clip(np.einsum("ka,ka->k", corner.at_M - start, way) / length2, 0.0, 1.0)
    nearest = float(np.linalg.norm(start + share[:, None] * way - corner.at_M, axis=1).min(initial=np.inf))
    return nearest if nearest <= corner.reach else float("nan")


def corner_overshoot(points: Array, corner: Corner) -> float:
    """Compute CO of one cycle (8.5.3) [m]: overshoot of the attained path (k, 3) [m] beyond the side after the corner.

    It is the largest component along the side before the corner, over points near the corner along the side after it;
    zero if no point is beyond, NaN without points.
    """
    off = points - corner.at_M
    own = (np.linalg.norm(off, axis=1) <= corner.reach) & (off @ corner.after_M >= 0.0)
    return max(float((off[own] @ corner.before_M).max()), 0.0) if own.any() else float("nan")
