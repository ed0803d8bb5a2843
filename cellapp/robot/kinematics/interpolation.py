"""Linear interpolation of tables whose rows belong to times or to positions along a path."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array

_Floats = NDArray[np.floating[Any]]


def rows_at(wanted: _Floats, places: _Floats, table: Array) -> Array:
    """Interpolate a ``table`` (n, k), given at increasing ``places`` (n,), at ``wanted`` (m,): rows (m, k).

    Outside the given places the first or last row is returned.
    """
    return np.column_stack([np.interp(wanted, places, column) for column in table.T])
