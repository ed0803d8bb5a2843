"""Distances between capsules: a collision monitor that is independent of the planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array


@dataclass
class Clearance:
    """Smallest distances so far, arm to arm and to the floor [m], with their times [s]; infinite before any sample."""

    arms_m: float = np.inf
    arms_time_s: float = np.nan
    floor_m: float = np.inf
    floor_time_s: float = np.nan

    def update_arms(self, distances: Array, times_s: Array) -> None:
        """Update with distances (..., n) between the arms at times (n,)."""
        self.arms_m, self.arms_time_s = _smaller(self.arms_m, self.arms_time_s, distances, times_s)

    def update_floor(self, distances: Array, times_s: Array) -> None:
        """Update with distances (..., n) from the floor at times (n,)."""
        self.floor_m, self.floor_time_s = _smaller(self.floor_m, self.floor_time_s, distances, times_s)


def _smaller(best: float, best_time_s: float, distances: Array, times_s: Array) -> tuple[float, float]:
    """Return the smallest of ``distances`` (..., n) and its time if below ``best``; else ``best`` and its time."""
    each = distances.reshape(-1, len(times_s)).min(axis=0, initial=np.inf)
    k = int(np.argmin(each))
    return (float(each[k]), float(times_s[k])) if each[k] < best else (best, best_time_s)


def _point_to_segment(p: Array, a: Array, b: Array) -> Array:
    segment = b - a
    square, to = _dot(segment, segment), p - a
    share = _dot(to, segment) / np.where(square > 0.0, square, 1.0)
    away = to - np.minimum(np.maximum(share, 0.0), 1.0)[..., None] * segment
    return np.sqrt(_dot(away, away))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def segment_distances(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the distances (...,) between the segments a-b and c-d with ends (..., 3).

    Two segments are closest at an end of one of them, or on their common normal if it meets both inside.
    """
    distance = np.minimum(
        np.minimum(_point_to_segment(a, c, d), _point_to_segment(b, c, d)),
        np.minimum(_point_to_segment(c, a, b), _point_to_segment(d, a, b)),
    )
    u, v, w = b - a, d - c, c - a
    uu, vv, uv, uw, vw = _dot(u, u), _dot(v, v), _dot(u, v), _dot(u, w), _dot(v, w)
    determinant = uu * vv - uv**2
    crossing = determinant > 1e-12 * uu * vv
    divisor = np.where(crossing, determinant, 1.0)
    s, t = (vv * uw - uv * vw) / divisor, (uv * uw - uu * vw) / divisor
    crossing &= (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    across = w + t[..., None] * v - s[..., None] * u
    nearest: Array = np.where(crossing, np.minimum(distance, np.sqrt(_dot(across, across))), distance)
    return nearest
