"""Detection of a tracker station or robot base that was moved during the run: this would invalidate every fit."""

from __future__ import annotations

import numpy as np

from cellapp.robot.kinematics.transforms import Array, apply, register

_COARSE_TRIALS = 24
"""Number of split points that are tried first, evenly over the readings; then all points around the best one."""
_FEWEST = 6
"""Least number of readings before and after a split point: registration needs three, twice as many leave residuals."""
_RATIO = 3.0
"""Ratio of the rms residual of one registration to that of two from which a move is reported. Unmodelled geometry
leaves a ratio near 1."""
_LEAST_M = 2e-3
"""Rms residual of one station below which no move is searched for: smaller steps are drift, which discovery finds."""


def station_change(p_B: Array, p_M: Array) -> int | None:
    """Find the first row measured after the station was moved; None if it was not moved.

    Register the points before and after a split point separately. The station was moved at the split point with the
    smallest residual, if that is far smaller than the residual of one registration of all points.

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
    """Compute the rms distance [m] of the points after registration."""
    off = p_M - apply(register(p_M, p_B), p_B)
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
