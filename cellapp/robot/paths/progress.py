"""Evaluate how a moving SMR followed a path in time: its delay, its speed, and its distance from the desired position.

A point at time t is compared with the path's position for time ``t - d``. The delay d of controller and timestamps is
the one with the least sum of squared deviations. Neighbouring points are correlated: uncertainties use their effective
number, from the first autocorrelation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.paths.cartesian import CartesianPath
from cellapp.robot.paths.timing import Trajectory

_DELAYS_S = (-0.1, 0.5)
"""Range of delays that are tried: no controller is later with streamed positions, no timestamp earlier."""
_STEP_S = 0.02
_FEWEST = 20
_WINDOW_S = 0.2
"""Time over which a speed is averaged, and time that is left out at both ends of a stretch at the desired speed."""
_AT_SPEED = 0.99
_CLOCKS = 50e-6
"""Relative standard uncertainty of a speed by different clock rates."""


@dataclass(frozen=True)
class Speed:
    """Speeds [m/s] where the path has its desired speed: desired, mean, standard uncertainty of the mean, and range
    from the slowest to the fastest 0.2 s; ``time_s`` is the time at that speed."""

    wanted: float
    mean: float
    standard_error: float
    fluctuation: float
    time_s: float


@dataclass(frozen=True)
class Followed:
    """Delay with its standard error [s]; rms and largest distance from the path's position at the delayed time [m];
    the speed, None if the desired one is never reached."""

    delay_s: float
    delay_error_s: float
    rms_m: float
    largest_m: float
    speed: Speed | None


def followed(path: CartesianPath, sent: Trajectory, time_s: Array, p_M: Array) -> Followed | None:
    """Evaluate points ``p_M`` (n, 3) [m] at times (n,) [s] since ``sent`` began; None if too few, or if at rest."""
    if len(time_s) < _FEWEST or sent.s[-1] <= 0.0:
        return None

    def cost(delay: float) -> float:
        return float(np.sum(_beside(path, sent, time_s - delay, p_M) ** 2))

    near = min(np.arange(*_DELAYS_S, _STEP_S).tolist(), key=cost)
    bounds = (near - _STEP_S, near + _STEP_S)
    refined = float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-6}).x)
    delay = min(near, refined, key=cost)
    when = time_s - delay
    within = (when > 0.0) & (when < sent.duration_s)
    if np.count_nonzero(within) < _FEWEST:
        return None
    when, left = when[within], _beside(path, sent, when[within], p_M[within])
    rate, tangent = _motion(path, sent, when)
    along = np.einsum("na,na->n", left, tangent)
    squares = float(np.sum(rate**2))
    error = float(along.std()) * math.sqrt(_alike(along) / squares) if squares > 0.0 else math.nan
    away = np.linalg.norm(left, axis=1)
    speed = _speed(path, sent, when, np.interp(when, sent.time_s, sent.s) + along)
    return Followed(delay, error, float(np.sqrt(np.mean(away**2))), float(away.max()), speed)


def _beside(path: CartesianPath, sent: Trajectory, when: Array, p_M: Array) -> Array:
    """Compute deviations (n, 3) [m] of points from the path's positions at times ``when`` (n,) [s]."""
    return np.asarray(p_M - path.positions(np.interp(when, sent.time_s, sent.s)))


def _motion(path: CartesianPath, sent: Trajectory, when: Array) -> tuple[Array, Array]:
    """Compute desired speeds (n,) [m/s] and directions (n, 3), zero at rest."""
    half = sent.period_s
    before, after = (np.interp(when + sign * half, sent.time_s, sent.s) for sign in (-1.0, 1.0))
    moved = path.positions(after) - path.positions(before)
    length = np.linalg.norm(moved, axis=1)
    tangent = np.where(length[:, None] > 1e-9, moved / np.maximum(length, 1e-12)[:, None], 0.0)
    return (after - before) / (2.0 * half), tangent


def _speed(path: CartesianPath, sent: Trajectory, when: Array, s: Array) -> Speed | None:
    """Evaluate the speed in all stretches at the first desired speed, from reached arc lengths ``s`` (n,) [m]."""
    wanted = float(path.speeds[0])
    full = np.diff(sent.s, prepend=sent.s[0]) / sent.period_s > _AT_SPEED * wanted
    same = path.wanted_speed(sent.s) == wanted
    stretches = [
        (first, last)
        for first, last in _runs(full & same, sent.time_s)
        if np.count_nonzero((when >= first) & (when <= last)) >= _FEWEST
    ]
    slopes, weights, left, fastest, slowest = [], [], [], -math.inf, math.inf
    for first, last in stretches:
        rows = np.flatnonzero((when >= first) & (when <= last))
        t = when[rows] - when[rows].mean()
        slopes.append(float(t @ s[rows] / (t @ t)))
        weights.append(float(t @ t))
        left.append(s[rows] - s[rows].mean() - slopes[-1] * t)
        each = max(2, round(_WINDOW_S / max(float(np.median(np.diff(when[rows]))), 1e-6)))
        if len(rows) > each:
            moved = (s[rows][each:] - s[rows][:-each]) / (when[rows][each:] - when[rows][:-each])
            fastest, slowest = max(fastest, float(moved.max())), min(slowest, float(moved.min()))
    if not slopes:
        return None
    mean = float(np.average(slopes, weights=weights))
    scatter = np.concatenate(left)
    noise = float(scatter.std()) * math.sqrt(_alike(scatter) / sum(weights))
    fluctuation = fastest - slowest if fastest >= slowest else 0.0
    return Speed(
        wanted, mean, math.hypot(noise, _CLOCKS * wanted), fluctuation, sum(last - first for first, last in stretches)
    )


def _runs(inside: NDArray[np.bool_], time_s: Array) -> list[tuple[float, float]]:
    """Return start and end times [s] of the runs of ``inside``, shortened at both ends by ``_WINDOW_S``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]])))
    ends = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    spans = [(float(time_s[first]) + _WINDOW_S, float(time_s[last - 1]) - _WINDOW_S) for first, last in ends]
    return [(first, last) for first, last in spans if last > first]


def _alike(values: Array) -> float:
    """Return how many correlated values count as one independent value, from their first autocorrelation."""
    values = values - values.mean()
    square = float(values @ values)
    rho = float(values[1:] @ values[:-1]) / square if square > 0.0 else 0.0
    rho = min(max(rho, 0.0), 0.999)
    return (1.0 + rho) / (1.0 - rho)
