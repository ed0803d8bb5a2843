"""Shapes of obstacles, each in a frame of its own, and their distances from segments. Metres.

Obstacles with their poses, and their distances to capsules: cheap lower bounds avoid most exact ones. Metres.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cellapp.ground.errors import InputError
from cellapp.ground.file_text import readable
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


# -- Solids bounded by triangle meshes; their distances are computed by FCL, part of the extra ``meshes``. Metres -----


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


# -- Solids from STL files, read by trimesh, which comes with the extra ``meshes`` ------------------------------------


_LARGEST_BYTES = 100_000_000
"""Upper limit of the file size: two million triangles in a binary file; drawings of parts have some ten thousand."""
_LARGEST_M = 100.0
"""Size beyond which a mesh was certainly drawn in another unit [m]."""


_ADVICE = "give the path of an STL file"


def load_mesh(file: str, scale: float) -> tuple[Mesh, Array]:
    """Read a solid from an STL file; return it with its centre in the file's coordinates (3,) [m].

    Parameters
    ----------
    file : str
    scale : float
        Converts the file's unit to metres.

    Raises
    ------
    InputError
        If the extra is not installed, the file cannot be read, or it bounds no solid.
    """
    with readable(file, _ADVICE):
        state = Path(file).stat()
    if state.st_size > _LARGEST_BYTES:
        raise InputError(f"{file}: {state.st_size / 1e6:.0f} MB; simplify the mesh to some ten thousand triangles")
    return _loaded(file, scale, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=32)
def _loaded(file: str, scale: float, _changed_ns: int, _bytes: int) -> tuple[Mesh, Array]:
    """Read the solid in a file; the cache reads it once for each state of the file."""
    try:
        import fcl  # noqa: F401
        import trimesh
    except ImportError:
        raise InputError(
            f"{file}: obstacles of shape mesh need packages that are not installed: pip install 'cellapp[meshes]'"
        ) from None
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # else it writes tracebacks of bad files to stderr
    try:
        with readable(file, _ADVICE):
            data = Path(file).read_bytes()
        if len(data) != 84 + 50 * int.from_bytes(data[80:84], "little"):
            data.decode()  # then it must be text
        with np.errstate(invalid="ignore", over="ignore"):  # bad numbers are checked below
            read = trimesh.load_mesh(io.BytesIO(data), file_type="stl")
    except ValueError:
        raise InputError(f"{file}: not an STL file, or cut short; export it again as STL") from None
    if not len(read.faces) or not np.isfinite(read.vertices).all():
        raise InputError(f"{file}: holds no triangles: not an STL file, empty or cut short; export it again as STL")
    vertices = np.asarray(read.vertices, dtype=np.float64) * scale
    if np.abs(vertices).max() > _LARGEST_M:
        raise InputError(
            f"{file}: reaches {np.abs(vertices).max():.4g} m with scale {scale:g}; a file in millimetres needs scale"
            " 0.001"
        )
    if not (read.is_watertight and read.is_winding_consistent):
        raise InputError(
            f"{file}: the mesh is not closed, or neighbouring triangles face opposite sides, so that inside and"
            " outside cannot be told; repair it in the program that made it, or use boxes and cylinders"
        )
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    return Mesh(vertices - centre, np.asarray(read.faces, dtype=np.int64)), centre


@dataclass(frozen=True, eq=False)
class ObstacleBody:
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

    def moved(self, T_A_B: Array) -> ObstacleBody:
        """Return the obstacle with its pose in frame A instead of B."""
        return ObstacleBody(self.name, self.shape, T_A_B @ self.pose, self.base_of)

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
        gaps = np.asarray(distance_of_boxes(self.shape.half, a, b) - radius)  # a lower bound of each
        near = ~(gaps > within)  # also where NaN
        if near.any():
            gaps[near] = self.shape.segment_distance(a[near], b[near]) - np.broadcast_to(radius, gaps.shape)[near]
        return gaps


def beam_gaps(obstacles: Sequence[ObstacleBody], source: Array, target: Array, within: float) -> Array:
    """Compute the smallest distance (n,) [m] of the beams from ``source`` (3,) to ``target`` (n, 3) from any obstacle.

    Distances above ``within`` [m] may be underestimated, but not below it. Infinite without obstacles.
    """
    gaps = np.full(len(target), np.inf)
    for obstacle in obstacles:
        np.minimum(gaps, obstacle.gaps(np.broadcast_to(source, target.shape), target, 0.0, within), out=gaps)
    return gaps
