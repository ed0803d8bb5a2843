"""Recordings of motion: samples of the joints and points of the tracker, each with the timestamps of its own device.

Timestamps are kept as the device gave them: irregular, repeated, with gaps and with steps of the clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class JointStream:
    """n samples of one arm with N joints, in the order in which the controller gave them; checked on import.

    Attributes
    ----------
    time_s : array, shape (n,)
        Timestamps of the controller's clock [s].
    q : array, shape (n, N)
        Joint positions [rad].
    qd : array, shape (n, N), or None
        Joint speeds [rad/s].
    other_q : array, shape (n, K), or None
        Joint positions of the other arm of the cell, if it moved meanwhile [rad].
    """

    time_s: Array = field(repr=False)
    q: Array = field(repr=False)
    qd: Array | None = field(default=None, repr=False)
    other_q: Array | None = field(default=None, repr=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class PointStream:
    """m points of the tracker, in the order in which they were measured; checked on import.

    Attributes
    ----------
    time_s : array, shape (m,)
        Timestamps of the tracker's clock [s].
    p_M : array, shape (m, 3)
        SMR centre in the tracker frame [m].
    sigma_m : array, shape (m,), or None
        Isotropic standard uncertainty of each point [m].
    held_out : array of bool, shape (m,), or None
        Mask of points that no fit may use (`split` validate); None if the file does not state it.
    """

    time_s: Array = field(repr=False)
    p_M: Array = field(repr=False)
    sigma_m: Array | None = field(default=None, repr=False)
    held_out: NDArray[np.bool_] | None = field(default=None, repr=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Data of one arm's controller and of the tracker during one motion."""

    name: str
    arm: str
    joints: JointStream
    points: PointStream


# -- Timestamps of a recording read as a clock: repeats, gaps, jitter, and steps of the clock -------------------------
#
# A step is a timestamp far before the last one, or far after it although the arm moved on by about one sample. Later
# timestamps are shifted so that time continues, and form a *segment* of their own: the fit gives each segment its own
# offset. Timestamps with jitter about a regular clock (arrival times at a host) are replaced by that clock if this
# makes the path smoother: the values themselves show which of the two is true.

_BACK_PERIODS, _BACK_S = 3.0, 0.02
"""A timestamp earlier by more than both is a step; less is jitter."""
_AHEAD_PERIODS, _AHEAD_S = 8.0, 0.05
"""A timestamp later by more than both may be a step; the values decide."""
_GAP_PERIODS, _GAP_S = 3.5, 0.03
"""Nothing is interpolated between samples further apart than both."""
_MOVED_PERIODS = 3.0
"""Motion across a step, in motions of one sample, up to which no sample is taken as missing."""
_BESIDE_S = 0.03
"""Time on either side of a step for estimating the speed there."""
_OF_SPREAD = 6.0
"""Standard errors by which the motion of one sample must exceed zero, to distinguish a step from a gap."""
_PHASE_S = 4.0
"""Duration over which timestamps share one phase of a regular clock."""
_NEARBY_PERIODS = ((1.0 + np.linspace(-0.04, 0.04, 81), 1.0), (1.0 + np.linspace(-0.001, 0.001, 21), 4.0))
"""Candidate periods, relative to the median step of timestamps, and the duration of averaged phases."""
_OF_PERIOD = 20_000
"""Number of timestamps for estimating the period."""
_SMOOTHING_S = 1.0
"""Duration over which timestamps are averaged into a regular clock."""
_STEADY = 0.01
"""Mean deviation of steps from a period, in periods, up to which timestamps are already those of a regular clock."""
_STRIDES = (1, 8)
"""Distances of neighbours that show jitter, and that show samples counted wrongly."""
_MUCH_SMOOTHER = 0.5
"""Ratio of the path's roughness below which regular timestamps replace the recorded ones."""
_MOST_POLLED, _MOST_OF_USUAL = 20, 4.0
"""Most polls of one value; largest multiple of the usual number for which repeats still count as polls."""
_STALE = 0.02
"""Share of samples that repeat the last values while the arm moves, above which they count as polled twice."""


@dataclass(frozen=True, eq=False)
class Stamps:
    """Timestamps repaired to a continuous clock.

    Attributes
    ----------
    rows : array of int, shape (m,)
        Indices of the kept samples: the first of each timestamp.
    fresh : array of int
        Indices of the samples that were not polled twice: all of each timestamp.
    time_s : array, shape (m,)
        Times of the kept samples [s], strictly increasing; those of the first segment as recorded.
    segment : array of int, shape (m,)
        Index of the part between steps of the clock, from 0.
    period_s : float
        Median time between samples.
    steps : tuple of pairs
        Steps of the clock: the timestamp before (repaired time [s]), and by how much it continued too late [s].
    """

    rows: NDArray[np.intp] = field(repr=False)
    fresh: NDArray[np.intp] = field(repr=False)
    time_s: Array = field(repr=False)
    segment: NDArray[np.intp] = field(repr=False)
    period_s: float
    steps: tuple[tuple[float, float], ...]

    def averaged(self, values: Array) -> Array:
        """Average recorded ``values`` (n, d) over the samples of each timestamp, (m, d)."""
        starts = np.searchsorted(self.fresh, self.rows)
        counts = np.diff(np.append(starts, len(self.fresh)))
        return np.asarray(np.add.reduceat(values[self.fresh], starts, axis=0) / counts[:, None])

    @property
    def longest_s(self) -> float:
        """Time between samples above which nothing is interpolated [s]."""
        return max(_GAP_PERIODS * self.period_s, _GAP_S)


def read_stamps(time_s: Array, values: Array) -> Stamps:
    """Read timestamps (n,) [s] of samples ``values`` (n, d): joint positions, or points.

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
    steps = tuple((float(running[i]), float(ahead[i] - period)) for i in np.flatnonzero(jump).tolist())
    time = running
    if float(np.minimum(np.abs(np.diff(running) / period - 1.0), 1.0).mean()) > _STEADY:
        clocks = (_counted(running, period), _by_phase(running, period))
        roughness, regular = min(((_roughness(clock, values), clock) for clock in clocks), key=lambda one: one[0])
        if roughness < _MUCH_SMOOTHER * _roughness(running, values):
            time = regular
    time, _, kept = _distinct(time, values)
    return Stamps(rows[kept], rows, time, segment[kept], period, steps)


def _fresh(values: Array) -> NDArray[np.intp]:
    """Return the indices of samples without those polled before the device had new values, while the arm moves.

    While the arm moves, a value is repeated a usual number of times, one or a few; a rest is longer.
    """
    n = len(values)
    same = np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])
    times = np.diff(np.append(np.flatnonzero(~same), n))
    usual = np.median(times) if len(times) > n // _MOST_POLLED else 1.0  # else the arm mostly rests
    stale = same & (times <= _MOST_OF_USUAL * usual).repeat(times)
    return np.flatnonzero(~stale) if stale.sum() > _STALE * n else np.arange(n)


def _steps(time: Array, values: Array, period: float) -> NDArray[np.bool_]:
    """Return a mask (n - 1,) of the samples after which the clock jumped."""
    ahead, beside = np.diff(time), int(np.clip(_BESIDE_S / period, 4, 40))
    jump = ahead < -max(_BACK_PERIODS * period, _BACK_S)
    for i in np.flatnonzero(ahead > max(_AHEAD_PERIODS * period, _AHEAD_S)).tolist():
        before, after = values[max(i - beside, 0) : i + 1], values[i + 1 : i + 2 + beside]
        if len(before) < 2 or len(after) < 2:
            continue
        each = (before[-1] - before[0]) / (len(before) - 1) / 2.0 + (after[-1] - after[0]) / (len(after) - 1) / 2.0
        missed = values[i + 1] - values[i] - each
        per_sample, off = float(np.linalg.norm(each)), float(np.linalg.norm(missed))
        spread = np.linalg.norm(np.diff(before, axis=0) - (before[-1] - before[0]) / (len(before) - 1), axis=1)
        moving = per_sample > _OF_SPREAD * float(spread.mean()) / np.sqrt(len(spread))
        jump[i] = moving and off < _MOVED_PERIODS * per_sample
    return jump


def _distinct(time: Array, values: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return times, values and rows without repeated timestamps."""
    kept = np.flatnonzero(np.concatenate([[True], np.diff(time) > 0.0]))
    return time[kept], values[kept], kept


def _counted(time: Array, period: float) -> Array:
    """Estimate the regular clock of timestamps with jitter and without losses: a moving average of timestamp minus
    index, between gaps."""
    regular = time.copy()
    cuts = np.flatnonzero(np.diff(time) > max(3.0 * _GAP_PERIODS * period, 3.0 * _GAP_S)) + 1
    half = max(2, round(_SMOOTHING_S / period / 2.0))
    for first, last in zip([0, *cuts.tolist()], [*cuts.tolist(), len(time)], strict=True):
        if last - first < 3 * half:
            continue
        number = np.arange(last - first)
        slope, at_zero = np.polyfit(number, time[first:last], 1)
        residual = time[first:last] - slope * number - at_zero
        regular[first:last] = (
            slope * number + at_zero + scipy.ndimage.uniform_filter1d(residual, 2 * half + 1, mode="nearest")
        )
    return np.maximum.accumulate(regular)


def _by_phase(time: Array, period: float) -> Array:
    """Estimate the regular clock of timestamps with jitter below a period, some of which may be lost: each one's index
    follows from the mean phase of its neighbours."""
    since, some = time - time[0], time[:_OF_PERIOD] - time[0]
    for near, seconds in _NEARBY_PERIODS:
        period = max(period * near, key=lambda its: float(np.abs(_turns(some, its, seconds)).mean()))
    phase = np.unwrap(np.angle(_turns(since, period, _PHASE_S))) / (2.0 * np.pi)
    number = np.maximum.accumulate(np.rint(since / period - phase))
    return np.asarray(time[0] + period * (number + phase))


def _turns(since: Array, period: float, seconds: float) -> NDArray[np.complex128]:
    """Return the mean phase of timestamps within some seconds, as complex numbers of length near 1 if phases agree."""
    phasors = np.exp(2j * np.pi * since / period)
    return np.asarray(
        scipy.ndimage.uniform_filter1d(phasors, 2 * max(2, round(seconds / period / 2.0)) + 1, mode="nearest")
    )


def _roughness(time: Array, values: Array) -> float:
    """Return the rms distance of samples from the cubic through their neighbours, next and more distant ones, in units
    of a sample's motion."""
    time, values, _ = _distinct(time, values)
    if len(time) < 8 * _STRIDES[-1]:
        return np.inf
    scale = float(np.median(np.linalg.norm(np.diff(values, axis=0), axis=1))) + 1e-300
    return math.hypot(*(_distance_from_cubic(time, values, stride, scale) for stride in _STRIDES))


def _distance_from_cubic(t: Array, x: Array, stride: int, scale: float) -> float:
    """Return the rms distance from the cubic through the samples one and two strides before and after."""
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
