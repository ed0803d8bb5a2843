"""Solids bounded by triangle meshes; their distances are computed by FCL, part of the extra ``meshes``. Metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.shapes import distance_of_boxes
from cellapp.robot.kinematics.transforms import Array

_AT_ONCE = 1_000_000
"""Pairs of a point and a triangle in a batch: some 100 MB."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A solid bounded by a closed triangle mesh, the centre of its bounding box at the origin.

    Attributes
    ----------
    vertices : array, shape (v, 3)
        [m].
    faces : array, shape (f, 3), int
        Indices into ``vertices``, with the same winding for all triangles.
    """

    vertices: Array
    faces: NDArray[np.int64]

    @cached_property
    def half(self) -> Array:
        """Half the sizes of the bounding box, shape (3,) [m]."""
        return np.asarray(np.abs(self.vertices).max(axis=0))

    def lower_bound(self, start: Array, end: Array) -> Array:
        """Compute distances (...) [m] from the bounding box to the bounding boxes of segments with ends (..., 3)."""
        return distance_of_boxes(self.half, start, end)

    def segment_distance(self, start: Array, end: Array) -> Array:
        """Compute distances (t,) [m] of segments with ends (t, 3); zero where they meet the solid, NaN for NaN."""
        distances = np.full(len(start), np.nan)
        for row in np.flatnonzero(np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)):
            distances[row] = self._surface_distance(start[row], end[row])
        # a segment that does not meet the surface is inside with all of its points or with none
        inside = np.flatnonzero((distances > 0.0) & np.all(np.abs(start) <= self.half, axis=1))
        distances[inside[self._contains(start[inside])]] = 0.0
        return distances

    @cached_property
    def _surface(self) -> Any:
        """The surface as FCL's bounding volume hierarchy."""
        return _collision_object(self.vertices, self.faces)

    def _surface_distance(self, start: Array, end: Array) -> float:
        """Compute the distance [m] of a segment from the surface as a triangle without area: there FCL is exact."""
        import fcl

        segment = _collision_object(np.array([start, 0.5 * (start + end), end]), np.array([[0, 1, 2]]))
        return max(float(fcl.distance(self._surface, segment)), 0.0)

    def _contains(self, points: Array) -> NDArray[np.bool_]:
        """Return whether points (t, 3) are inside, by the solid angle of the surface as seen from them.

        Source: Van Oosterom, Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125.
        """
        inside = np.zeros(len(points), dtype=bool)
        block = max(1, _AT_ONCE // len(self.faces))
        for begin in range(0, len(points), block):
            corners = self.vertices[self.faces] - points[begin : begin + block, None, None]
            a, b, c = np.moveaxis(corners, 2, 0)
            length_a, length_b, length_c = np.linalg.norm(corners, axis=3).transpose(2, 0, 1)
            volume = np.einsum("tfa,tfa->tf", a, np.cross(b, c))
            flat = length_a * length_b * length_c
            flat += np.einsum("tfa,tfa->tf", a, b) * length_c + np.einsum("tfa,tfa->tf", b, c) * length_a
            flat += np.einsum("tfa,tfa->tf", c, a) * length_b
            angle = 2.0 * np.arctan2(volume, flat).sum(axis=1)
            inside[begin : begin + block] = np.abs(angle) > 2.0 * np.pi  # 4 pi inside, 0 outside
        return inside


def _collision_object(vertices: Array, faces: NDArray[np.int64]) -> Any:
    import fcl

    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(faces))
    model.addSubModel(vertices, faces)
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform())
