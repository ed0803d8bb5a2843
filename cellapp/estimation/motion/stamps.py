"""Stamps of a recording read as a clock: repeats, gaps, jitter, and steps of the clock.

A step is a stamp far before the last one, or far after it although the arm moved on by about one sample. Later stamps
are shifted back so that time runs on, and are a *segment* of their own: the fit gives each segment its own offset.
Stamps that jitter about a regular clock (arrival times at a host) are replaced by that clock where this makes the path
smoother: the values themselves tell which of the two is true.
"""

from __future__ import annotations

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
_SMOOTHING_S = 1.0
"""Length of stamps that are averaged into a regular clock."""
_MUCH_SMOOTHER = 0.7
"""Ratio of the path's roughness from which regular stamps are taken in place of those that were recorded."""
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
    regular = _regular(running, period)
    smoother = _roughness(regular, values) < _MUCH_SMOOTHER * _roughness(*_distinct(running, values)[:2])
    time = regular if smoother else running
    time, _, kept = _distinct(time, values)
    longest = max(_GAP_PERIODS * period, _GAP_S)
    gaps = int(np.count_nonzero(np.diff(time) > longest))
    return Stamps(rows[kept], rows, time, segment[kept], period, repeated, gaps, steps, bool(smoother))


def _fresh(values: Array) -> NDArray[np.intp]:
    """Samples without those that repeat the last values while the arm moves: polled before the device had new ones."""
    n = len(values)
    same = np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])
    moving = np.zeros(n, dtype=bool)
    moving[1:-2] = (values[3:] != values[:-3]).any(axis=1) & ~(same[1:-2] & same[2:-1])
    stale = same & moving
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


def _regular(time: Array, period: float) -> Array:
    """The regular clock about which stamps jitter: a moving average of stamp less number, between gaps."""
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


def _roughness(time: Array, values: Array) -> float:
    """Rms distance of samples from the parabola through their neighbours, in units of a sample's motion."""
    if len(time) < 8 or (np.diff(time) <= 0.0).any():
        return np.inf
    t, x = time, values
    scale = np.median(np.linalg.norm(np.diff(x, axis=0), axis=1)) + 1e-300
    a, b, c, d = t[:-4], t[1:-3], t[3:-1], t[4:]
    at = t[2:-2]
    predicted = np.zeros_like(x[2:-2])
    for own, others, rows in (
        (a, (b, c, d), slice(0, -4)),
        (b, (a, c, d), slice(1, -3)),
        (c, (a, b, d), slice(3, -1)),
        (d, (a, b, c), slice(4, None)),
    ):
        weight = np.ones(len(at))
        for other in others:
            weight = weight * (at - other) / (own - other)
        predicted += weight[:, None] * x[rows]
    miss = np.linalg.norm(x[2:-2] - predicted, axis=1)
    return float(np.sqrt(np.mean(np.minimum(miss / scale, 5.0) ** 2)))
