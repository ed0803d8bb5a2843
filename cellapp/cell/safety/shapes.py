"""Shapes of obstacles, each in a frame of its own, and their distances from segments. Metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from cellapp.robot.kinematics.transforms import Array

_BISECTIONS = 32
"""Bisection steps in the search for the point of a segment nearest to a cylinder: to 1e-9 m for segments of metres."""
_LEAST_SLOPE_M = 1e-12
"""Least component of a segment along an axis [m]; smaller ones count as zero."""


class Shape(Protocol):
    """A solid about the origin of its own frame."""

    @property
    def half(self) -> Array:
        """Half the sizes of its bounding box about the origin, shape (3,) [m]."""

    def lower_bound(self, start: Array, end: Array) -> Array:
        """Compute quick lower bounds (...) [m] of the distances of segments with ends (..., 3); NaN where an end is."""

    def segment_distance(self, start: Array, end: Array) -> Array:
        """Compute distances (t,) [m] of segments with ends (t, 3) from the solid; zero or negative where they meet it.

        Never more than the true distance, beyond rounding. NaN where an end is NaN.
        """


@dataclass(frozen=True, eq=False)
class RoundedBox:
    """All points within ``radius`` of a box; with ``core`` partly zero also a sphere or a capsule.

    Attributes
    ----------
    core : array, shape (3,)
        Half the sizes of the box [m].
    radius : float
        [m].
    """

    core: Array
    radius: float = 0.0

    @cached_property
    def half(self) -> Array:
        """Half the sizes of the bounding box, shape (3,) [m]."""
        return self.core + self.radius

    def lower_bound(self, start: Array, end: Array) -> Array:
        """Compute distances (...) [m] of the bounding boxes of segments with ends (..., 3)."""
        return distance_of_boxes(self.core, start, end) - self.radius

    def segment_distance(self, start: Array, end: Array) -> Array:
        """Compute distances (t,) [m] of segments with ends (t, 3); exact outside, -radius inside the core.

        The squared distance from the box is convex and piecewise quadratic along a segment, with breakpoints where a
        coordinate leaves the box: between two of them the derivative is linear, and its zero is the nearest point.
        """
        u = end - start
        slope = np.where(np.abs(u) > _LEAST_SLOPE_M, u, np.inf)
        t = np.zeros((len(u), 8))
        t[:, 1] = 1.0
        np.clip((self.core - start) / slope, 0.0, 1.0, out=t[:, 2:5])
        np.clip((-self.core - start) / slope, 0.0, 1.0, out=t[:, 5:8])
        derivative = np.einsum("tia,ta->ti", self._outside(start[:, None] + t[..., None] * u[:, None]), u)
        rows = np.arange(len(u))
        before = np.argmax(np.where(derivative <= 0.0, t, -1.0), axis=1)  # index 0, which is t = 0, if there is none
        after = np.argmin(np.where(derivative > 0.0, t, 2.0), axis=1)
        low, high = derivative[rows, before], derivative[rows, after]
        rising = high > np.maximum(low, 0.0)
        share = np.where(rising, -low / np.where(rising, high - low, 1.0), 0.0)
        nearest = t[rows, before] + np.clip(share, 0.0, 1.0) * (t[rows, after] - t[rows, before])
        gap = np.linalg.norm(self._outside(start + nearest[:, None] * u), axis=1)
        return np.asarray(gap - self.radius)

    def _outside(self, points: Array) -> Array:
        """Return the vectors from the nearest point of the box to each of ``points`` (..., 3)."""
        return points - np.clip(points, -self.core, self.core)


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A cylinder with flat ends, its axis along z; ``radius`` and ``half_length`` in [m]."""

    radius: float
    half_length: float

    @cached_property
    def half(self) -> Array:
        """Half the sizes of the bounding box, shape (3,) [m]."""
        return np.array([self.radius, self.radius, self.half_length])

    def lower_bound(self, start: Array, end: Array) -> Array:
        """Combine least distances (...) [m] across and along the axis, each by itself, for segments (..., 3)."""
        x, y = start[..., 0], start[..., 1]
        ux, uy = end[..., 0] - x, end[..., 1] - y
        t = np.clip(-(x * ux + y * uy) / np.maximum(ux * ux + uy * uy, _LEAST_SLOPE_M**2), 0.0, 1.0)
        radial = np.maximum(np.hypot(x + t * ux, y + t * uy) - self.radius, 0.0)
        low, high = np.minimum(start[..., 2], end[..., 2]), np.maximum(start[..., 2], end[..., 2])
        return np.hypot(radial, np.maximum(np.maximum(low, -high) - self.half_length, 0.0))

    def segment_distance(self, start: Array, end: Array) -> Array:
        """Compute distances (t,) [m] of segments with ends (t, 3), at most about 1e-9 m too small; zero inside.

        The squared distance from a convex solid is convex along a segment: its derivative is bisected. A distance
        changes by no more than the path length along the segment, hence the bound.
        """
        (x, y, z), (ux, uy, uz) = start.T, (end - start).T
        low, high = np.zeros(len(start)), np.ones(len(start))
        for _ in range(_BISECTIONS):
            t = 0.5 * (low + high)
            px, py, pz = x + t * ux, y + t * uy, z + t * uz
            rho = np.hypot(px, py)
            radial = np.maximum(rho - self.radius, 0.0) / np.maximum(rho, self.radius)
            axial = pz - np.clip(pz, -self.half_length, self.half_length)
            rises = radial * (px * ux + py * uy) + axial * uz > 0.0
            high = np.where(rises, t, high)
            low = np.where(rises, low, t)
        ends = [self._point_distance(start + t[:, None] * (end - start)) for t in (low, high)]
        length = np.linalg.norm(end - start, axis=1)
        return np.asarray(np.maximum(np.minimum(*ends) - 0.5 * (high - low) * length, 0.0))

    def _point_distance(self, points: Array) -> Array:
        """Compute distances (t,) [m] of points (t, 3); zero inside."""
        radial = np.maximum(np.hypot(points[:, 0], points[:, 1]) - self.radius, 0.0)
        return np.hypot(radial, np.maximum(np.abs(points[:, 2]) - self.half_length, 0.0))


def distance_of_boxes(half: Array, start: Array, end: Array) -> Array:
    """Compute distances (...) [m] from the box about the origin with half sizes (3,) to those of segments (..., 3)."""
    apart = np.maximum(np.maximum(np.minimum(start, end), -np.maximum(start, end)) - half, 0.0)
    return np.asarray(np.sqrt(np.einsum("...a,...a->...", apart, apart)))
