"""Obstacles with their poses, and their distances to capsules: cheap lower bounds avoid most exact ones. Metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellapp.cell.safety.shapes import Shape
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A named solid at a pose.

    Attributes
    ----------
    name : str
        As in the profile.
    shape : Shape
    pose : array, shape (4, 4)
        Of the shape's frame: in the cell frame C, or in the flange frame for one that is mounted on an arm.
    base_of : str or None
        The arm to whose base it is fixed.
    """

    name: str
    shape: Shape
    pose: Array
    base_of: str | None = None

    @cached_property
    def reach(self) -> Array:
        """Half the sizes, (3,) [m], of its bounding box along the axes of the frame in which the pose is given."""
        return np.asarray(np.abs(self.pose[:3, :3]) @ self.shape.half)

    def moved(self, T_A_B: Array) -> Obstacle:
        """Return the obstacle with its pose in frame A instead of B."""
        return Obstacle(self.name, self.shape, T_A_B @ self.pose, self.base_of)

    def far(self, low: Array, high: Array, distance: float) -> bool:
        """Return whether all points between the corners ``low`` and ``high`` (3,) are farther than ``distance`` [m]."""
        centre = self.pose[:3, 3]
        apart = np.maximum(low - centre, centre - high) - self.reach
        return bool(np.max(apart) > distance)

    def gaps(self, start: Array, end: Array, radius: Array | float, within: Array | float) -> Array:
        """Compute distances [m] of capsules from the obstacle; zero or negative where they meet it.

        Parameters
        ----------
        start, end : array, shape (..., 3)
            Ends of the capsules' axes, in the frame in which the pose is given [m].
        radius : array that broadcasts to (...)
            [m].
        within : array that broadcasts to (...)
            Distances above this one may be underestimated, but not below it [m].

        Returns
        -------
        gaps : array, shape (...)
        """
        a, b = ((points - self.pose[:3, 3]) @ self.pose[:3, :3] for points in (start, end))
        gaps = np.asarray(self.shape.lower_bound(a, b) - radius)
        near = ~(gaps > within)  # also where NaN
        if near.any():
            gaps[near] = self.shape.segment_distance(a[near], b[near]) - np.broadcast_to(radius, gaps.shape)[near]
        return gaps


def box_about(start: Array, end: Array, radius: Array) -> tuple[Array, Array]:
    """Compute the corners (3,) of the bounding box of all capsules: ends (n, m, 3), radius (m,) [m]."""
    thickness = radius[:, None]
    low = (np.minimum(start.min(axis=0), end.min(axis=0)) - thickness).min(axis=0)
    high = (np.maximum(start.max(axis=0), end.max(axis=0)) + thickness).max(axis=0)
    return low, high


def beam_gaps(obstacles: Sequence[Obstacle], source: Array, target: Array, within: float) -> Array:
    """Compute the smallest distance (n,) [m] of the beams from ``source`` (3,) to ``target`` (n, 3) from any obstacle.

    Distances above ``within`` [m] may be underestimated, but not below it. Infinite without obstacles.
    """
    gaps = np.full(len(target), np.inf)
    for obstacle in obstacles:
        np.minimum(gaps, obstacle.gaps(np.broadcast_to(source, target.shape), target, 0.0, within), out=gaps)
    return gaps
