"""Solids from STL files, read by trimesh, which comes with the extra ``meshes``."""

from __future__ import annotations

import io
import logging
from functools import lru_cache
from pathlib import Path

import numpy as np

from cellapp.cell.safety.meshes import Mesh
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array

_LARGEST_BYTES = 100_000_000
"""Upper limit of the file size: two million triangles in a binary file; drawings of parts have some ten thousand."""
_LARGEST_M = 100.0
"""Size beyond which a mesh was certainly drawn in another unit [m]."""


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
    try:
        state = Path(file).stat()
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); give the path of an STL file") from None
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
        data = Path(file).read_bytes()
        if len(data) != 84 + 50 * int.from_bytes(data[80:84], "little"):
            data.decode()  # then it must be text
        with np.errstate(invalid="ignore", over="ignore"):  # bad numbers are checked below
            read = trimesh.load_mesh(io.BytesIO(data), file_type="stl")
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); give the path of an STL file") from None
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
