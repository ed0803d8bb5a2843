"""The test cube of ISO 9283 (6.8), its inclined planes and the poses P1 to P5 in them.

Corners C1 to C4 go round the upper face, C5 to C8 are below them. Each of the standard's four planes holds one edge of
the upper face and the opposite one of the lower face. P1 is the centre; P2 to P5 are on the diagonals of the plane,
10 % of their length from the corners. All poses have the same orientation.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array

DIRECTIONS = ("x", "y", "z")
"""Directions of approach, along the axes of the arm's base (7.2.3)."""
DIRECTIONAL_POSES = ("P1", "P2", "P4")

CORNERS: Mapping[str, tuple[int, int, int]] = MappingProxyType(
    {
        "C1": (-1, -1, 1),
        "C2": (1, -1, 1),
        "C3": (1, 1, 1),
        "C4": (-1, 1, 1),
        "C5": (-1, -1, -1),
        "C6": (1, -1, -1),
        "C7": (1, 1, -1),
        "C8": (-1, 1, -1),
    }
)
"""Signs of each corner relative to the centre along x, y and z of the arm's base."""
PLANES: tuple[tuple[str, str, str, str], ...] = (
    ("C1", "C2", "C7", "C8"),
    ("C2", "C3", "C8", "C5"),
    ("C3", "C4", "C5", "C6"),
    ("C4", "C1", "C6", "C7"),
)
"""Planes a to d of the standard, in its order."""
POSES = ("P1", "P2", "P3", "P4", "P5")
CYCLE = ("P5", "P4", "P3", "P2", "P1")
"""Order of visits in a cycle that begins at P1 (7.2): every pose is always reached from the same previous pose."""
_INSET = 0.1
"""Distance of P2 to P5 from the ends of the diagonals, as share of their length; the standard allows 0.08 to 0.12."""
LARGE_CIRCLE, SMALL_CIRCLE = 0.8, 0.08
"""Diameters of the test circles as shares of the cube's edge (6.8): the small one is a tenth of the large one."""
_CIRCLE_POINTS = 4
"""Number of points on the circle, which is two arcs through them."""


def plane_name(plane: tuple[str, str, str, str]) -> str:
    """Return the plane's name in the standard, "C1-C2-C7-C8"."""
    return "-".join(plane)


def pose_positions(centre: Array, edge: float, plane: tuple[str, str, str, str]) -> dict[str, Array]:
    """Return positions (3,) [m] of P1 to P5 for a cube about ``centre`` (3,) [m]; P2 to P5 are near the corners."""
    reach = 0.5 * edge * (1.0 - 2.0 * _INSET)
    corners = [centre + reach * np.array(CORNERS[name]) for name in plane]
    return dict(zip(POSES, [np.asarray(centre), *corners], strict=True))


def circle_positions(poses: Mapping[str, Array], edge: float, share: float = LARGE_CIRCLE) -> Array:
    """Return points (5, 3) [m] a quarter turn apart on a circle about P1 in the plane of the poses, the first twice.

    ``share`` is the diameter as a share of the cube's edge. The first point lies towards the middle of P2 and P3.
    """
    centre = poses["P1"]
    first = 0.5 * (poses["P2"] + poses["P3"]) - centre
    second = 0.5 * (poses["P3"] + poses["P4"]) - centre
    first, second = first / np.linalg.norm(first), second / np.linalg.norm(second)
    angle = np.linspace(0.0, 2.0 * np.pi, _CIRCLE_POINTS + 1)[:, None]
    return np.asarray(centre + 0.5 * share * edge * (np.cos(angle) * first + np.sin(angle) * second))


def lattice_cube(points: NDArray[np.bool_]) -> tuple[int, tuple[int, int, int]] | None:
    """Find the largest all-True cube in a mask (a, b, c); return the steps along its edge and its first corner.

    None if no point is True. Of cubes of the same size, take the one whose first corner comes first.
    """
    if not points.any():
        return None
    edge, held = 0, points
    while True:
        larger = held
        for axis in range(3):
            low = [slice(None)] * 3
            high = [slice(None)] * 3
            low[axis], high[axis] = slice(None, -1), slice(1, None)
            larger = larger[tuple(low)] & larger[tuple(high)]
        if not larger.any():
            first = np.argwhere(held)[0]
            return edge, (int(first[0]), int(first[1]), int(first[2]))
        edge, held = edge + 1, larger
