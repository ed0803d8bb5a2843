"""Capsules that cover a solid: what is mounted on a flange is checked as further bodies of its arm."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellapp.cell.safety.obstacles import Obstacle
from cellapp.cell.safety.shapes import Cylinder, RoundedBox
from cellapp.robot.kinematics.transforms import Array, apply

_MOST_CAPSULES = 8
"""Largest number of capsules in a cover: as many as a six-joint arm has, so that checks take at most twice as long."""


@dataclass(frozen=True, eq=False)
class Cover:
    """Capsules that contain a solid; ``excess`` is the farthest that they reach beyond it [m].

    ``start``, ``end`` (c, 3) are in the frame in which the obstacle's pose is given [m], ``radius`` (c,) in [m]. The
    excess over a mesh is counted from its bounding box.
    """

    start: Array
    end: Array
    radius: Array
    excess: float


def cover(obstacle: Obstacle) -> Cover:
    """Cover an obstacle by capsules; exact for spheres and capsules."""
    shape = obstacle.shape
    if isinstance(shape, RoundedBox):
        found = _box_cover(shape.core, shape.radius)
    elif isinstance(shape, Cylinder):
        around_box = _box_cover(shape.half, 0.0)
        corner = (math.sqrt(2.0) - 1.0) * shape.radius
        found = min(
            _cylinder_cover(shape),
            Cover(around_box.start, around_box.end, around_box.radius, around_box.excess + corner),
            key=lambda one: one.excess,
        )
    else:
        found = _box_cover(shape.half, 0.0)
    return Cover(apply(obstacle.pose, found.start), apply(obstacle.pose, found.end), found.radius, found.excess)


def _cylinder_cover(shape: Cylinder) -> Cover:
    """Cover by one capsule through both rims, shortened until its excess at the ends equals that at the side."""
    inset = min(shape.radius, shape.half_length)
    radius = math.hypot(shape.radius, inset)
    end = np.array([[0.0, 0.0, shape.half_length - inset]])
    return Cover(-end, end, np.array([radius]), radius - inset)


def _box_cover(core: Array, rounding: float) -> Cover:
    """Cover by capsules along the longest side of a box, each containing one tile of a grid over the other two sides.

    A capsule around a tile with half sides p, q passes through its corners; it is shortened by min(p, q), so that its
    excess at the ends equals that at the larger faces. Of all grids the one with the smallest excess is taken.
    """
    along = int(np.argmax(core))
    first, second = (axis for axis in range(3) if axis != along)
    best: tuple[float, int, int] | None = None
    for rows in range(1, _MOST_CAPSULES + 1):
        for columns in range(1, _MOST_CAPSULES // rows + 1):
            p, q = core[first] / rows, core[second] / columns
            excess = math.hypot(p, q, min(p, q)) - min(p, q)
            if best is None or excess < best[0] - 1e-9:
                best = excess, rows, columns
    assert best is not None
    excess, rows, columns = best
    p, q = core[first] / rows, core[second] / columns
    centres = np.zeros((rows * columns, 3))
    u, v = np.meshgrid((2 * np.arange(rows) + 1 - rows) * p, (2 * np.arange(columns) + 1 - columns) * q)
    centres[:, first], centres[:, second] = u.ravel(), v.ravel()
    axis = np.zeros(3)
    axis[along] = core[along] - min(p, q)
    radius = np.full(len(centres), math.hypot(p, q, min(p, q)) + rounding)
    return Cover(centres - axis, centres + axis, radius, excess)
