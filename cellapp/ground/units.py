"""Units that a caller may have mistaken."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_WIDEST_RAD = 4.0 * math.pi
"""Two turns: more than the range of any joint of an industrial arm."""


def first_in_degrees(q: NDArray[Any]) -> tuple[int, int] | None:
    """Row and column of the first joint position that can only be in degrees, among ``q`` (n, N) meant as [rad].

    None unless most rows have one: a single row may be wrong without being in degrees.
    """
    wide = np.abs(q) > _WIDEST_RAD
    if 2 * np.count_nonzero(wide.any(axis=1)) <= len(q):
        return None
    row, joint = np.argwhere(wide)[0].tolist()
    return row, joint
