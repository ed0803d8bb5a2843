"""Solids bounded by triangle meshes (STL). Needs the extra ``meshes``: trimesh reads files, FCL finds distances."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.safety.shapes import distance_of_boxes

_LARGEST_BYTES = 100_000_000
"""Two million triangles in a binary file; drawings of parts have some ten thousand."""
_LARGEST_M = 100.0
"""Size beyond which a mesh was certainly drawn in another unit [m]."""
_AT_ONCE = 1_000_000
"""Pairs of a point and a triangle at once: some 100 MB."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A solid bounded by a closed triangle mesh, the centre of its bounding box at the origin.

    Attributes
    ----------
    vertices : array, shape (v, 3)
        [m].
    faces : array, shape (f, 3), int
        Indices into ``vertices``, in the same sense of rotation all over.
    """

    vertices: Array
    faces: NDArray[np.int64]

    @cached_property
    def half(self) -> Array:
        """Half the sizes of the bounding box, shape (3,) [m]."""
        return np.asarray(np.abs(self.vertices).max(axis=0))

    def lower_bound(self, start: Array, end: Array) -> Array:
        """Distances (...) [m] of the boxes about segments with ends (..., 3) from the bounding box."""
        return distance_of_boxes(self.half, start, end)

    def segment_distance(self, start: Array, end: Array) -> Array:
        """Distances (t,) [m] of segments with ends (t, 3); zero where they meet the solid, NaN where an end is NaN."""
        distances = np.full(len(start), np.nan)
        for row in np.flatnonzero(np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)):
            distances[row] = self._surface_distance(start[row], end[row])
        # a segment that does not meet the surface is inside with all of its points or with none
        inside = np.flatnonzero((distances > 0.0) & np.all(np.abs(start) <= self.half, axis=1))
        distances[inside[self._contains(start[inside])]] = 0.0
        return distances

    @cached_property
    def _surface(self) -> Any:
        """The surface as FCL's tree of boxes."""
        return _collision_object(self.vertices, self.faces)

    def _surface_distance(self, start: Array, end: Array) -> float:
        """Distance [m] of a segment from the surface: a triangle without area, whose distances FCL finds exactly."""
        import fcl

        segment = _collision_object(np.array([start, 0.5 * (start + end), end]), np.array([[0, 1, 2]]))
        return max(float(fcl.distance(self._surface, segment)), 0.0)

    def _contains(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (t, 3) are inside, by the solid angle that the surface fills as seen from them.

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


def load_mesh(file: str, scale: float) -> tuple[Mesh, Array]:
    """Read a solid from an STL file, with the place of its centre in the file's coordinates (3,) [m].

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
    try:
        state = Path(file).stat()
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); give the path of an STL file") from None
    if state.st_size > _LARGEST_BYTES:
        raise InputError(f"{file}: {state.st_size / 1e6:.0f} MB; simplify the mesh to some ten thousand triangles")
    return _loaded(file, scale, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=32)
def _loaded(file: str, scale: float, _changed_ns: int, _bytes: int) -> tuple[Mesh, Array]:
    """The solid in a file, read once for each state of the file."""
    try:
        import fcl  # noqa: F401
        import trimesh
    except ImportError:
        raise InputError(
            f"{file}: obstacles of shape mesh need packages that are not installed: pip install 'cellapp[meshes]'"
        ) from None
    try:
        data = Path(file).read_bytes()
        if len(data) != _binary_length(data):
            data.decode()  # then it must be text
        read = trimesh.load_mesh(io.BytesIO(data), file_type="stl")
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); give the path of an STL file") from None
    except ValueError:
        raise InputError(f"{file}: not an STL file, or cut short; export it again as STL") from None
    if not len(read.faces) or not np.isfinite(read.vertices).all():
        raise InputError(f"{file}: holds no triangles: not an STL file, empty or cut short; export it again as STL")
    if not (read.is_watertight and read.is_winding_consistent):
        raise InputError(
            f"{file}: the mesh is not closed, or neighbouring triangles face opposite sides, so that inside and"
            " outside cannot be told; repair it in the program that made it, or use boxes and cylinders"
        )
    vertices = np.asarray(read.vertices, dtype=np.float64) * scale
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if np.abs(vertices).max() > _LARGEST_M:
        raise InputError(
            f"{file}: reaches {np.abs(vertices).max():.0f} m with scale {scale:g}; a file in millimetres needs scale"
            " 0.001"
        )
    centre = 0.5 * (low + high)
    return Mesh(vertices - centre, np.asarray(read.faces, dtype=np.int64)), centre


def _binary_length(data: bytes) -> int:
    """Length of a binary STL file by its header: 80 bytes, the number of triangles, 50 bytes for each."""
    return 84 + 50 * int.from_bytes(data[80:84], "little")
