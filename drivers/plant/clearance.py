"""Distances between capsules, for a witness of collisions that trusts no planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array


@dataclass
class Clearance:
    """The smallest distances seen so far [m]; infinite while nothing has been seen."""

    arms_m: float = np.inf
    arms_time_s: float = np.nan
    floor_m: float = np.inf
    floor_time_s: float = np.nan


def _point_to_segment(p: Array, a: Array, b: Array) -> Array:
    way = b - a
    square = (way * way).sum(axis=-1)
    share = ((p - a) * way).sum(axis=-1) / np.where(square > 0.0, square, 1.0)
    nearest = a + np.clip(share, 0.0, 1.0)[..., None] * way
    distance: Array = np.linalg.norm(p - nearest, axis=-1)
    return distance


def segment_distances(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Distances (...,) between the segments a-b and c-d, ends (..., 3).

    Two segments are nearest at an end of one of them, or at the common normal where it meets both inside.
    """
    distance = np.minimum(
        np.minimum(_point_to_segment(a, c, d), _point_to_segment(b, c, d)),
        np.minimum(_point_to_segment(c, a, b), _point_to_segment(d, a, b)),
    )
    u, v, w = b - a, d - c, c - a
    uu, vv, uv = (u * u).sum(axis=-1), (v * v).sum(axis=-1), (u * v).sum(axis=-1)
    uw, vw = (u * w).sum(axis=-1), (v * w).sum(axis=-1)
    determinant = uu * vv - uv**2
    crossing = determinant > 1e-12 * uu * vv
    divisor = np.where(crossing, determinant, 1.0)
    s, t = (vv * uw - uv * vw) / divisor, (uv * uw - uu * vw) / divisor
    crossing &= (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    gap = np.linalg.norm(w + t[..., None] * v - s[..., None] * u, axis=-1)
    nearest: Array = np.where(crossing, np.minimum(distance, gap), distance)
    return nearest
