"""Linear interpolation of tables of which each row is at a time, or at another place along a path."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array

_Floats = NDArray[np.floating[Any]]


def rows_at(wanted: _Floats, places: _Floats, table: Array) -> Array:
    """Rows (m, k) at ``wanted`` (m,) of a ``table`` (n, k) that is given at growing ``places`` (n,).

    Before the first and after the last place they are the first and the last row.
    """
    return np.column_stack([np.interp(wanted, places, column) for column in table.T])
