"""Formulas for settling at a pose: stabilisation time, overshoot, posing time (7.4, 7.5 and 9).

The standard's text was not at hand; the definitions are those commonly given. Stabilisation begins when the SMR enters
the limit band about its rest position, and ends when it stays inside. The overshoot is its largest distance from the
rest position in between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.robot.kinematics.transforms import Array

REST_S = 0.5
"""Time at the end of a record in which the arm is at rest: the mean of these points is the rest position."""
_START_S = 0.1
"""Time at the beginning of a record in which the arm has not yet moved."""


@dataclass(frozen=True)
class Settled:
    """Settling of one motion to a pose: times [s] and overshoot [m], zero if the SMR did not leave the band again."""

    stabilisation_s: float
    overshoot_m: float
    posing_s: float


def settled(time_s: Array, points: Array, band_m: float) -> Settled | None:
    """Evaluate the record of one motion; None if it does not begin or end at rest.

    Parameters
    ----------
    time_s : array, shape (k,)
        Times in order [s].
    points : array, shape (k, 3)
        Measured positions [m].
    band_m : float
        Radius of the limit band about the position at rest [m].
    """
    last, first = time_s >= time_s[-1] - REST_S, time_s <= time_s[0] + _START_S
    off = np.linalg.norm(points - points[last].mean(axis=0), axis=1)
    away = np.linalg.norm(points - points[first].mean(axis=0), axis=1)
    if (off[last] > band_m).any() or off[first].min() <= 2.0 * band_m:
        return None
    entered = int(np.argmax(off <= band_m))
    stays = int(np.flatnonzero(off > band_m)[-1]) + 1
    left = int(np.argmax(away > band_m))
    largest = float(off[entered:].max())
    return Settled(
        stabilisation_s=float(time_s[stays] - time_s[entered]),
        overshoot_m=largest if largest > band_m else 0.0,
        posing_s=float(time_s[stays] - time_s[left]),
    )
