"""Stamps of a recording read as a clock: repeats, gaps, jitter, and steps of the clock.

A step is a stamp far before the last one, or far after it although the arm moved on by about one sample. Later stamps
are shifted back so that time runs on, and are a *segment* of their own: the fit gives each segment its own offset.
Stamps that jitter about a regular clock (arrival times at a host) are replaced by that clock where this makes the path
smoother: the values themselves tell which of the two is true.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array

_BACK_PERIODS, _BACK_S = 3.0, 0.02
"""A stamp earlier by more than both is a step; less is jitter."""
_AHEAD_PERIODS, _AHEAD_S = 8.0, 0.05
"""A stamp later by more than both may be a step; the values decide."""
_GAP_PERIODS, _GAP_S = 3.5, 0.03
"""Between samples further apart than both nothing is interpolated."""
_MOVED_PERIODS = 3.0
"""Motion across a step, in motions of one sample, up to which no sample is missing."""
_BESIDE_S = 0.03
"""Time on either side of a step from which the speed there is taken."""
_OF_SPREAD = 6.0
"""Standard errors that the motion of one sample must be above, to tell a step from a gap."""
_PHASE_S = 4.0
"""Length of stamps that have one phase of a regular clock."""
_NEARBY_PERIODS = (
    (1.0 + np.linspace(-0.04, 0.04, 81), 1.0),
    (1.0 + np.linspace(-0.001, 0.001, 21), 4.0),
)
"""Periods that stamps may have, in the median step between them, and the length of stamps that tells."""
_OF_PERIOD = 20_000
"""Stamps that tell the period."""
_SMOOTHING_S = 1.0
"""Length of stamps that are averaged into a regular clock."""
_STEADY = 0.01
"""Mean distance of steps from a period, in periods, up to which stamps are those of a regular clock as they are."""
_STRIDES = (1, 8)
"""Neighbours that show jitter, and those that show samples that were counted wrongly."""
_MUCH_SMOOTHER = 0.5
"""Ratio of the path's roughness from which regular stamps are taken in place of those that were recorded."""
_MOST_POLLED, _MOST_OF_USUAL = 20, 4.0
"""Times that a device is polled for one value at most; times the usual number that a value stands there by chance."""
_STALE = 0.02
"""Share of samples that repeat the last values while the arm moves, from which they count as polled twice."""


@dataclass(frozen=True)
class ClockStep:
    """A clock jumped: after the stamp ``at_s`` (repaired time [s]) it went on ``step_s`` later than it should have."""

    at_s: float
    step_s: float


@dataclass(frozen=True, eq=False)
class Stamps:
    """A clock that runs on.

    Attributes
    ----------
    rows : array of int, shape (m,)
        Samples that are kept, of those recorded: the first of each stamp.
    fresh : array of int
        Samples without those that were polled twice: all of each stamp.
    time_s : array, shape (m,)
        Their times [s], strictly increasing; those of the first segment as recorded.
    segment : array of int, shape (m,)
        Part between steps of the clock, from 0.
    period_s : float
        Median time between samples.
    repeated, gaps : int
        Stamps that repeat the one before; pauses in which samples are missing.
    steps : tuple of ClockStep
    regular : bool
        Whether stamps jittered about a regular clock, which took their place.
    """

    rows: NDArray[np.intp] = field(repr=False)
    fresh: NDArray[np.intp] = field(repr=False)
    time_s: Array = field(repr=False)
    segment: NDArray[np.intp] = field(repr=False)
    period_s: float
    repeated: int
    gaps: int
    steps: tuple[ClockStep, ...]
    regular: bool

    def averaged(self, values: Array) -> Array:
        """Recorded ``values`` (n, d), averaged over the samples of each stamp, (m, d)."""
        starts = np.searchsorted(self.fresh, self.rows)
        counts = np.diff(np.append(starts, len(self.fresh)))
        return np.asarray(np.add.reduceat(values[self.fresh], starts, axis=0) / counts[:, None])

    @property
    def longest_s(self) -> float:
        """Time between samples from which nothing is interpolated [s]."""
        return max(_GAP_PERIODS * self.period_s, _GAP_S)


def read_stamps(time_s: Array, values: Array) -> Stamps:
    """Read stamps (n,) [s] of samples ``values`` (n, d): joint positions, or points.

    Raises
    ------
    ValueError
        If fewer than two different stamps are left.
    """
    rows = _fresh(values)
    stamped, values = time_s[rows], values[rows]
    ahead = np.diff(stamped)
    if not (ahead > 0.0).any():
        raise ValueError("all stamps are the same")
    period = float(np.median(ahead[ahead > 0.0]))
    jump = _steps(stamped, values, period)
    shift = np.concatenate([[0.0], np.cumsum(np.where(jump, ahead - period, 0.0))])
    running = np.maximum.accumulate(stamped - shift)
    segment = np.concatenate([[0], np.cumsum(jump)]).astype(np.intp)
    steps = tuple(ClockStep(float(running[i]), float(ahead[i] - period)) for i in np.flatnonzero(jump).tolist())
    repeated = int(np.count_nonzero(np.diff(running) <= 0.0))
    time, smoother = running, False
    if float(np.minimum(np.abs(np.diff(running) / period - 1.0), 1.0).mean()) > _STEADY:
        clocks = (_counted(running, period), _by_phase(running, period))
        roughness, regular = min(((_roughness(clock, values), clock) for clock in clocks), key=lambda one: one[0])
        smoother = roughness < _MUCH_SMOOTHER * _roughness(running, values)
        time = regular if smoother else running
    time, _, kept = _distinct(time, values)
    longest = max(_GAP_PERIODS * period, _GAP_S)
    gaps = int(np.count_nonzero(np.diff(time) > longest))
    return Stamps(rows[kept], rows, time, segment[kept], period, repeated, gaps, steps, smoother)


def _fresh(values: Array) -> NDArray[np.intp]:
    """Samples without those that repeat the last values while the arm moves: polled before the device had new ones.

    How often each value stands there while the arm moves is one count or a few; a rest is longer.
    """
    n = len(values)
    same = np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])
    times = np.diff(np.append(np.flatnonzero(~same), n))
    usual = np.median(times) if len(times) > n // _MOST_POLLED else 1.0  # else it mostly rests
    stale = same & (times <= _MOST_OF_USUAL * usual).repeat(times)
    return np.flatnonzero(~stale) if stale.sum() > _STALE * n else np.arange(n)


def _steps(time: Array, values: Array, period: float) -> NDArray[np.bool_]:
    """Whether the clock jumped after each sample but the last, (n - 1,)."""
    ahead, beside = np.diff(time), int(np.clip(_BESIDE_S / period, 4, 40))
    jump = ahead < -max(_BACK_PERIODS * period, _BACK_S)
    for i in np.flatnonzero(ahead > max(_AHEAD_PERIODS * period, _AHEAD_S)).tolist():
        before, after = values[max(i - beside, 0) : i + 1], values[i + 1 : i + 2 + beside]
        if len(before) < 2 or len(after) < 2:
            continue
        each = (before[-1] - before[0]) / (len(before) - 1) / 2.0 + (after[-1] - after[0]) / (len(after) - 1) / 2.0
        missed = values[i + 1] - values[i] - each
        per_sample, left = float(np.linalg.norm(each)), float(np.linalg.norm(missed))
        spread = np.linalg.norm(np.diff(before, axis=0) - (before[-1] - before[0]) / (len(before) - 1), axis=1)
        moving = per_sample > _OF_SPREAD * float(spread.mean()) / np.sqrt(len(spread))
        jump[i] = moving and left < _MOVED_PERIODS * per_sample
    return jump


def _distinct(time: Array, values: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Times, values and rows without those whose stamp repeats the one before."""
    kept = np.flatnonzero(np.concatenate([[True], np.diff(time) > 0.0]))
    return time[kept], values[kept], kept


def _counted(time: Array, period: float) -> Array:
    """The regular clock about which stamps jitter, of which none is lost: a moving average of stamp less number,
    between gaps."""
    regular = time.copy()
    cuts = np.flatnonzero(np.diff(time) > max(3.0 * _GAP_PERIODS * period, 3.0 * _GAP_S)) + 1
    half = max(2, round(_SMOOTHING_S / period / 2.0))
    for first, last in zip([0, *cuts.tolist()], [*cuts.tolist(), len(time)], strict=True):
        if last - first < 3 * half:
            continue
        number = np.arange(last - first)
        slope, at_zero = np.polyfit(number, time[first:last], 1)
        left = time[first:last] - slope * number - at_zero
        regular[first:last] = (
            slope * number + at_zero + scipy.ndimage.uniform_filter1d(left, 2 * half + 1, mode="nearest")
        )
    return np.maximum.accumulate(regular)


def _by_phase(time: Array, period: float) -> Array:
    """The regular clock about which stamps jitter by less than a period, of which some may be lost: each stamp's number
    follows from the mean phase of the stamps about it."""
    since, some = time - time[0], time[:_OF_PERIOD] - time[0]
    for near, seconds in _NEARBY_PERIODS:
        period = max(period * near, key=lambda its: float(np.abs(_turns(some, its, seconds)).mean()))
    phase = np.unwrap(np.angle(_turns(since, period, _PHASE_S))) / (2.0 * np.pi)
    number = np.maximum.accumulate(np.rint(since / period - phase))
    return np.asarray(time[0] + period * (number + phase))


def _turns(since: Array, period: float, seconds: float) -> NDArray[np.complex128]:
    """Mean of the phases of stamps within some seconds, as complex numbers; near length 1 where they are alike."""
    turned = np.exp(2j * np.pi * since / period)
    return np.asarray(
        scipy.ndimage.uniform_filter1d(turned, 2 * max(2, round(seconds / period / 2.0)) + 1, mode="nearest")
    )


def _roughness(time: Array, values: Array) -> float:
    """Rms distance of samples from the cubic through their neighbours, next ones and more distant ones, in units of a
    sample's motion."""
    time, values, _ = _distinct(time, values)
    if len(time) < 8 * _STRIDES[-1]:
        return np.inf
    scale = float(np.median(np.linalg.norm(np.diff(values, axis=0), axis=1))) + 1e-300
    return math.hypot(*(_distance_from_cubic(time, values, stride, scale) for stride in _STRIDES))


def _distance_from_cubic(t: Array, x: Array, stride: int, scale: float) -> float:
    """Rms distance from the cubic through the samples one and two strides before and after."""
    n = len(t) - 4 * stride
    places = [slice(k * stride, k * stride + n) for k in range(5)]
    middle, others = places.pop(2), places
    predicted = np.zeros((n, x.shape[1]))
    for own in others:
        weight = np.ones(n)
        for other in others:
            if other is not own:
                weight *= (t[middle] - t[other]) / (t[own] - t[other])
        predicted += weight[:, np.newaxis] * x[own]
    miss = np.linalg.norm(x[middle] - predicted, axis=1)
    return float(np.sqrt(np.mean(np.minimum(miss / scale, 5.0) ** 2)))
