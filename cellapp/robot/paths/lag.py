"""Measure how joints follow streamed positions: a common delay, which is no path error, and deviations from the path.

A controller's filter cuts corners: with the variance ``V`` of its impulse response, joints are at ``q(t - delay) +
V q'' / 2``. The filter is unknown, but the encoders show its result. A rehearsed path is corrected by that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize_scalar

from cellapp.robot.kinematics.transforms import Array, rows_at
from cellapp.robot.model import ArmModel
from cellapp.robot.paths.timing import Rates, Trajectory

_LONGEST_S = 0.5
"""Largest delay that is searched: no controller is later with streamed positions."""
_SMOOTHED_S = 0.03
"""Standard deviation of the smoothing of encoder readings: their steps must not be sent back to the arm."""
_TAPERED_S = 0.15
"""Time in which the correction fades in and out: at both ends the joints lag only along the path, and the arm rests."""
_FEWEST = 10


@dataclass(frozen=True)
class Lag:
    """Delay of the joints [s], distance of the tool in that time at top speed [m], largest path deviation [m]."""

    delay_s: float
    late_m: float
    cut_m: float


def lag(arm: ArmModel, sent: Trajectory, time_s: Array, q: Array) -> Lag | None:
    """Measure the lag of joints at ``q`` (m, N) [rad], times (m,) [s] since ``sent`` began; None if too few."""
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
    """Correct ``sent`` by the deviations seen when it was followed, so that the joints then follow it better.

    None if that would exceed the limits of the joints, or there are too few times (m,).
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
    """Find the delay [s] with which the reached positions fit those sent best."""

    def missed(delay_s: float) -> float:
        return float(np.mean((q - _at(sent, time_s - delay_s)) ** 2))

    return float(minimize_scalar(missed, bounds=(0.0, _LONGEST_S), method="bounded", options={"xatol": 1e-5}).x)


def _at(sent: Trajectory, time_s: Array) -> Array:
    """Interpolate the positions (n, N) [rad] that were sent for times (n,)."""
    return rows_at(time_s, sent.time_s, sent.q)
