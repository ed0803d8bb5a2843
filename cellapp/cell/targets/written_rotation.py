"""Read the rotation of a target: roll, pitch and yaw, a quaternion, a rotation vector or a matrix."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated

import numpy as np
from pydantic import AllowInfNan, Strict, TypeAdapter

from cellapp.cell.targets.target_source import checked, placed_error
from cellapp.robot.kinematics.transforms import Array, rotation_from_vector, rotations_of, zyx_angles
from drivers.quantities import Turn

_LARGEST = 1e-3
"""Largest deviation from one of a quaternion's norm, or of a matrix times its transpose: rounding to three digits.
Beyond it is no rotation, or one that was copied wrongly."""
_Number = Annotated[float, Strict(), AllowInfNan(False)]
_ROW = tuple[_Number, _Number, _Number]
_QUATERNION: TypeAdapter[tuple[float, ...]] = TypeAdapter(tuple[_Number, _Number, _Number, _Number])
_VECTOR: TypeAdapter[tuple[float, ...]] = TypeAdapter(tuple[Turn, Turn, Turn])
_MATRIX: TypeAdapter[tuple[tuple[float, ...], ...]] = TypeAdapter(tuple[_ROW, _ROW, _ROW])
ROTATIONS = ("rpy", "quaternion", "rotation_vector", "matrix")
"""Keys of which a target gives one, or none if any rotation will do."""


def with_rpy(values: object) -> object:
    """Return the keys of a target with ``rpy`` in place of another kind of rotation.

    Raises
    ------
    PydanticCustomError
        If two rotations are given, or the value is no rotation. It is placed at the key.
    """
    if not isinstance(values, Mapping):
        return values
    given = [key for key in ROTATIONS if values.get(key) is not None]
    if len(given) > 1:
        raise placed_error((given[1],), f"'{given[0]}' is there too; give one of {', '.join(ROTATIONS)}")
    if _READERS.keys().isdisjoint(values):
        return values
    others = {name: value for name, value in values.items() if name not in _READERS}
    if not given or given == ["rpy"]:
        return others
    yaw, pitch, roll = zyx_angles(_READERS[given[0]](values[given[0]]))
    return {**others, "rpy": (roll + 0.0, pitch + 0.0, yaw + 0.0)}  # no -0.0


# -- inside -----------------------------------------------------------------------------------------------------------


def _of_quaternion(value: object) -> Array:
    w, x, y, z = checked(_QUATERNION, value, ("quaternion",))
    norm = math.hypot(w, x, y, z)
    if abs(norm - 1.0) > _LARGEST:
        raise placed_error(
            ("quaternion",),
            f"its norm is {norm:.6g}, {abs(norm - 1.0):.2g} from one (at most {_LARGEST:g}), so it is no rotation; give"
            " w, x, y, z of unit norm",
        )
    return rotations_of((w, x, y, z))


def _of_vector(value: object) -> Array:
    return rotation_from_vector(checked(_VECTOR, value, ("rotation_vector",)))


def _of_matrix(value: object) -> Array:
    matrix = np.array(checked(_MATRIX, value, ("matrix",)))
    with np.errstate(over="ignore", invalid="ignore"):  # entries of 1e200
        off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if not off <= _LARGEST:
        raise placed_error(
            ("matrix",),
            f"its rows are off unit length and right angles by {off:.2g} (at most {_LARGEST:g}), so it is no rotation;"
            " give three rows of unit length at right angles",
        )
    if np.linalg.det(matrix) < 0.0:
        raise placed_error(("matrix",), "its determinant is -1: a reflection, no rotation; give right-handed axes")
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)  # the nearest rotation


_READERS: Mapping[str, Callable[[object], Array]] = {
    "quaternion": _of_quaternion,
    "rotation_vector": _of_vector,
    "matrix": _of_matrix,
}
