"""Detection of a tracker station or robot base that was moved during the run, which would invalidate every fit."""

from __future__ import annotations

import numpy as np

from cellapp.robot.kinematics.transforms import Array, apply, register

_COARSE_TRIALS = 24
"""Places that are tried first, evenly over the readings; then all places around the best one."""
_FEWEST = 6
"""Readings on either side of a place: registration needs three, twice as many leave a residual."""
_RATIO = 3.0
"""Ratio of the rms residual of one registration to that of two from which a move is reported. Unmodelled geometry
leaves a ratio near 1."""
_LEAST_M = 2e-3
"""Rms residual of one station below which no move is looked for: smaller steps are drift, which discovery finds."""


def station_change(p_B: Array, p_M: Array) -> int | None:
    """First row measured after the station was moved, or None.

    The points before and after a place are registered separately. The station was moved at the place where this leaves
    the smallest residual, if that is far smaller than the residual of one registration of all points.

    Parameters
    ----------
    p_B : array, shape (n, 3)
        SMR positions in the base frame by the nominal geometry [m], in the order of measurement.
    p_M : array, shape (n, 3)
        Measured SMR positions in the tracker frame [m].
    """
    n = len(p_B)
    if n < 2 * _FEWEST:
        return None
    together = _registration_rms(p_B, p_M)
    if together < _LEAST_M:
        return None

    def separate(k: int) -> float:
        before, after = _registration_rms(p_B[:k], p_M[:k]), _registration_rms(p_B[k:], p_M[k:])
        return float(np.sqrt((k * before**2 + (n - k) * after**2) / n))

    step = max(1, (n - 2 * _FEWEST) // _COARSE_TRIALS)
    row = min(range(_FEWEST, n - _FEWEST + 1, step), key=separate)
    row = min(range(max(_FEWEST, row - step), min(n - _FEWEST, row + step) + 1), key=separate)
    return row if together > _RATIO * separate(row) else None


def _registration_rms(p_B: Array, p_M: Array) -> float:
    """Rms distance of the points after registration [m]."""
    off = p_M - apply(register(p_M, p_B), p_B)
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
