"""Did the tracker stand still? A station that changed half-way spoils every fit, so it is looked for first."""

from __future__ import annotations

import numpy as np

from cellapp.kinematics.transforms import Array, apply, register

_TRIALS = 24
_FEWEST = 6
_WORSE = 3.0
_LEAST_M = 2e-3


def station_change(p_B: Array, p_M: Array) -> int | None:
    """The row at which measured points stop fitting one station, or None.

    For a number of places in the order of measurement, the points before and those behind are registered apart; a moved
    station is there if that fits much better than one registration of all. Steps below two millimetres are drift, not a
    new station, and are left to discovery.

    Parameters
    ----------
    p_B : array, shape (n, 3)
        SMR positions in the base frame by the published geometry [m], in the order they were measured.
    p_M : array, shape (n, 3)
        The measured ones in the tracker frame [m].
    """
    n = len(p_B)
    if n < 2 * _FEWEST:
        return None
    together = _rms(p_B, p_M)
    if together < _LEAST_M:
        return None

    def apart(k: int) -> float:
        return float(np.sqrt((k * _rms(p_B[:k], p_M[:k]) ** 2 + (n - k) * _rms(p_B[k:], p_M[k:]) ** 2) / n))

    step = max(1, (n - 2 * _FEWEST) // _TRIALS)
    place = min(range(_FEWEST, n - _FEWEST + 1, step), key=apart)
    place = min(range(max(_FEWEST, place - step), min(n - _FEWEST, place + step) + 1), key=apart)
    return place if together > _WORSE * apart(place) else None


def _rms(p_B: Array, p_M: Array) -> float:
    """What registration leaves [m], root mean square."""
    off = p_M - apply(register(p_M, p_B), p_B)
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
