"""How joints follow a stream of positions: late as a whole, which is no error of the path, and beside it.

A controller's filter cuts bends: with the variance ``V`` of its impulse response, joints are at ``q(t - delay) +
V q'' / 2``. The filter is not known; what it did is, from the encoders. A rehearsed path is corrected by that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize_scalar

from cellapp.robot.kinematics.interpolation import rows_at
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.paths.timing import Rates, Trajectory

_LONGEST_S = 0.5
"""No controller is later with a stream of positions."""
_SMOOTHED_S = 0.03
"""Standard deviation of the smoothing of what the encoders showed: their steps must not be sent back to the arm."""
_TAPERED_S = 0.15
"""Correction fades in and out: at both ends the joints lag along the path only, and the arm rests there."""
_FEWEST = 10


@dataclass(frozen=True)
class Lag:
    """Delay of the joints [s], the way of the tool in it at the path's fastest, and the most it leaves the path [m]."""

    delay_s: float
    late_m: float
    cut_m: float


def lag(arm: ArmModel, sent: Trajectory, time_s: Array, q: Array) -> Lag | None:
    """The lag of joints that were at ``q`` (m, N) [rad] at times (m,) [s] since ``sent`` began; None for too few."""
    if len(time_s) < _FEWEST:
        return None
    delay_s = _delay_s(sent, time_s, q)
    late = time_s - delay_s
    beside = arm.predict(q) - arm.predict(_at(sent, late))
    way = arm.predict(_at(sent, late + sent.period_s)) - arm.predict(_at(sent, late - sent.period_s))
    length = np.linalg.norm(way, axis=1)
    moving = length > 1e-9
    tangent = way[moving] / length[moving, None]
    across = beside[moving] - np.einsum("na,na->n", beside[moving], tangent)[:, None] * tangent
    fastest = float(np.max(np.abs(np.diff(sent.s)), initial=0.0)) / sent.period_s
    return Lag(delay_s, delay_s * fastest, float(np.linalg.norm(across, axis=1).max(initial=0.0)))


def rehearsed(sent: Trajectory, time_s: Array, q: Array, rates: Rates) -> Trajectory | None:
    """The positions to send so that the joints go where ``sent`` has them, after they were seen to follow it.

    None where that would exceed the limits of the joints, or there are too few times (m,) to judge by.
    """
    if len(time_s) < _FEWEST:
        return None
    later = sent.time_s + _delay_s(sent, time_s, q)
    reached = rows_at(later, time_s, q)
    missed = gaussian_filter1d(reached - sent.q, _SMOOTHED_S / sent.period_s, axis=0, mode="nearest")
    from_ends_s = np.minimum(sent.time_s, np.minimum(sent.duration_s, time_s[-1]) - sent.time_s)
    x = np.clip(from_ends_s / _TAPERED_S, 0.0, 1.0)
    corrected = replace(sent, q=sent.q - (x**3 * (10.0 - x * (15.0 - 6.0 * x)))[:, None] * missed)
    speed, acceleration = corrected.largest_rates()
    within = (speed <= rates.speed).all() and (acceleration <= rates.acceleration).all()
    return corrected if within else None


# -- inside -----------------------------------------------------------------------------------------------------------


def _delay_s(sent: Trajectory, time_s: Array, q: Array) -> float:
    """The delay that brings what was reached closest to what was sent."""

    def missed(delay_s: float) -> float:
        return float(np.mean((q - _at(sent, time_s - delay_s)) ** 2))

    return float(minimize_scalar(missed, bounds=(0.0, _LONGEST_S), method="bounded", options={"xatol": 1e-5}).x)


def _at(sent: Trajectory, time_s: Array) -> Array:
    """Positions (n, N) [rad] that were to be reached at times (n,)."""
    return rows_at(time_s, sent.time_s, sent.q)
