"""Preparation of a recording for the fit: joint path, points, clock segments, held-out blocks, start."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import TooFewReadings, start_from_nominal
from cellapp.estimation.motion.laws import TimedPath, joint_path
from cellapp.estimation.motion.streams import Recording, Stamps, read_stamps
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array

# -- Start of a clock: the delay between two recordings by correlating SMR speeds, and the base there -----------------
#
# The speed of the SMR by the tracker, ``|dp/dt|``, is compared with that of the nominal chain, ``|J qd|``, at all
# delays with enough overlap, by the correlation coefficient over common times (Padfield, IEEE Trans. Image Process. 21
# (2012) 2706: masked normalised correlation by Fourier transforms). Speeds do not depend on the base. Periodic sweeps
# correlate at many delays: among the best few, the fit of the nominal arm to the points decides, and if several fit
# alike, the longer overlap.


_GRID_S = 0.02
"""Step of the delays; a fit converges from ten times as far."""
_MOST_STEPS = 2**18
"""Most steps; longer recordings are compared on a coarser grid."""
_LEAST_OVERLAP = 0.2
"""Share of the shorter recording, and seconds, that must overlap."""
_LEAST_OVERLAP_S = 5.0
_STILL_M_S = 1e-3
"""Rms speed below which a recording is at rest."""
_PEAKS = 4
"""Number of delays tried with the nominal arm."""
_NEAR_BEST = 0.2
"""Difference from the best correlation up to which another delay is tried."""
_ALIKE = 3.0
"""Ratio of median distances up to which two delays fit alike."""
_APART_S = 0.3
"""Distance below which two peaks are one."""
_TRIED_POINTS = 300
_FEWEST_POINTS = 10
_REFINED = 3
"""Number of refinements of a delay by the residuals along the motion."""
_TOOL_SPAN_M = 0.1
"""Distance from the flange of the points over which speeds are averaged if the tool is unknown."""


@dataclass(frozen=True)
class ClockStart:
    """Tracker's timestamps less those of the controller [s], the correlation of the speeds there, and the nominal arm
    at its base; ``rms_m`` is the median distance of the points from it, ``others_s`` are delays that fit alike."""

    offset_s: float
    correlation: float
    nominal: Geometry
    rms_m: float
    others_s: tuple[float, ...] = ()


def clock_start(
    nominal: Geometry, path: TimedPath, time_s: Array, p_M: Array, *, tool_unknown: bool, where: str
) -> ClockStart:
    """Find the delay at which the points (m, 3) [m] with timestamps ``time_s`` (m,) fit the path of the joints.

    ``where`` names the recording in messages.

    Raises
    ------
    InputError
        If one of both is at rest, or they do not overlap.
    """
    own = path.stamps.time_s
    step = max(_GRID_S, (own[-1] - own[0]) / _MOST_STEPS, (time_s[-1] - time_s[0]) / _MOST_STEPS)
    by_joints, by_points = _joint_speeds(nominal, path, step, tool_unknown), _point_speeds(time_s, p_M, step)
    _check_moving(where, "joints", by_joints)
    _check_moving(where, "points", by_points)
    correlation, delays, overlap = _masked_correlation(by_joints, by_points, step)
    if not np.isfinite(correlation).any():
        raise InputError(f"{where}: the joints and the points have no {_LEAST_OVERLAP_S:g} s in common; record both")
    # a point with timestamp t was measured at controller time own[0] + (t - time_s[0]) + delay
    found = [
        _tried(nominal, path, time_s, p_M, time_s[0] - own[0] - delays[peak], correlation[peak], tool_unknown)
        for peak in _peaks(correlation, overlap, step)
    ]
    fitting = [one for one in found if one is not None]
    if not fitting:
        raise InputError(f"{where}: too few points lie within the recording of the joints; record both longer")
    least = min(one.rms_m for one in fitting)
    alike = [one for one in fitting if one.rms_m <= _ALIKE * least]  # the longest overlap comes first
    return replace(alike[0], others_s=tuple(one.offset_s for one in alike[1:]))


def _check_moving(where: str, what: str, speed: Array) -> None:
    known = speed[np.isfinite(speed)]
    if not len(known) or float(np.sqrt(np.mean(known**2))) < _STILL_M_S:
        raise InputError(
            f"{where}: the {what} are at rest (rms speed below {_STILL_M_S * 1e3:g} mm/s): nothing tells the delay"
            " between the clocks; record a motion, or import the stops as readings"
        )


def _joint_speeds(nominal: Geometry, path: TimedPath, step: float, tool_unknown: bool) -> Array:
    """Return speeds of the SMR of the nominal arm [m/s] on a grid of times; NaN where unknown."""
    t = path.stamps.time_s
    grid = np.arange(t[0], t[-1] - step, step)
    early, late = path.at(grid)[0], path.at(grid + step)[0]
    tools = [nominal.tool]
    if tool_unknown:
        tools = [nominal.tool + _TOOL_SPAN_M * sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    squares = np.zeros(len(grid))
    for tool in tools:
        arm = nominal.with_vector(np.concatenate([nominal.vector()[:-3], tool]))
        squares += np.sum((smr_positions(arm, late) - smr_positions(arm, early)) ** 2, axis=1)
    return np.where(path.known(grid) & path.known(grid + step), np.sqrt(squares / len(tools)) / step, np.nan)


def _point_speeds(time_s: Array, p_M: Array, step: float) -> Array:
    """Return speeds of the points [m/s] on a grid of times, without gross errors; NaN where unknown."""
    grid = np.arange(time_s[0], time_s[-1], step)
    place = np.clip(np.searchsorted(time_s, grid, side="right"), 1, len(time_s) - 1)
    known = time_s[place] - time_s[place - 1] < 3.0 * max(step, float(np.median(np.diff(time_s))))
    p = np.column_stack([np.interp(grid, time_s, scipy.ndimage.median_filter(p_M[:, axis], 5)) for axis in range(3)])
    speed = scipy.ndimage.median_filter(np.linalg.norm(np.diff(p, axis=0), axis=1) / step, 5)
    return np.where(known[1:] & known[:-1], speed, np.nan)


def _masked_correlation(a: Array, b: Array, step: float) -> tuple[Array, Array, Array]:
    """Return correlation coefficients of ``a[i + k]`` and ``b[i]`` where both are known, delays ``k step`` [s], and
    numbers of common samples.

    Coefficients are NaN if the overlap is too short.
    """
    size = scipy.fft.next_fast_len(len(a) + len(b), real=True)
    ma, mb = (np.isfinite(one).astype(np.float64) for one in (a, b))
    a, b = (np.where(np.isfinite(one), one - one[np.isfinite(one)].mean(), 0.0) for one in (a, b))

    def correlate(x: Array, y: Array) -> Array:
        return np.asarray(scipy.fft.irfft(scipy.fft.rfft(x, size) * np.conj(scipy.fft.rfft(y, size)), size))

    n = np.maximum(correlate(ma, mb), 0.0)
    enough = n >= max(_LEAST_OVERLAP * min(ma.sum(), mb.sum()), _LEAST_OVERLAP_S / step)
    n = np.maximum(n, 1.0)
    sa, sb = correlate(a, mb), correlate(ma, b)
    va, vb = correlate(a * a, mb) - sa**2 / n, correlate(ma, b * b) - sb**2 / n
    varies = (va > 1e-9 * va.max()) & (vb > 1e-9 * vb.max())
    with np.errstate(invalid="ignore", divide="ignore"):
        coefficient = (correlate(a, b) - sa * sb / n) / np.sqrt(va * vb)
    coefficient[~(enough & varies)] = np.nan
    places = np.arange(size)
    delays = np.where(places < len(a), places, places - size) * step
    return coefficient, np.asarray(delays), n


def _peaks(correlation: Array, overlap: Array, step: float) -> list[int]:
    """Return the indices of peaks nearly as high as the best with the longest overlaps, and of the best, by overlap."""
    heights = np.where(np.isfinite(correlation), correlation, -np.inf)
    highest = scipy.ndimage.maximum_filter1d(heights, 2 * max(1, round(_APART_S / step)) + 1, mode="wrap")
    found = np.flatnonzero((heights == highest) & (heights >= heights.max() - _NEAR_BEST))
    longest = found[np.argsort(-overlap[found], kind="stable")][:_PEAKS].tolist()
    best = int(np.argmax(heights))
    return longest if best in longest else [*longest, best]


def _tried(
    nominal: Geometry, path: TimedPath, time_s: Array, p_M: Array, offset: float, correlation: float, tool_unknown: bool
) -> ClockStart | None:
    """Fit the base of the nominal arm for one delay and refine the delay; None if too few points overlap."""
    for _ in range(_REFINED + 1):
        known = np.flatnonzero(path.known(time_s - offset))
        if len(known) < _FEWEST_POINTS:
            return None
        some = known[np.linspace(0, len(known) - 1, min(_TRIED_POINTS, len(known))).astype(np.intp)]
        q, _ = path.at(time_s[some] - offset)
        try:
            arm = start_from_nominal(nominal, q, p_M[some], tool_unknown=tool_unknown)
        except TooFewReadings:
            return None
        computed = smr_positions(arm, q)
        residuals = p_M[some] - computed
        misses = np.linalg.norm(residuals, axis=1)
        found = ClockStart(offset, float(correlation), arm, float(np.median(misses)))
        # delays are known to a grid step: the residuals along the motion give the rest
        moved = smr_positions(arm, path.at(time_s[some] - offset + _GRID_S)[0]) - computed
        usual = misses <= 3.0 * found.rms_m
        share = float(np.vdot(moved[usual], residuals[usual]) / max(float(np.vdot(moved[usual], moved[usual])), 1e-300))
        offset -= _GRID_S * float(np.clip(share, -3.0, 3.0))
    return found


_HELD_OUT_SHARE = 0.2
_BLOCKS = 25
"""Number of blocks of time of a recording; a share of them is held out."""
_SHORTEST_BLOCK_S = 2.0
_GUARD_S = 0.3
"""Guard time beside a held-out block; points in it are neither training nor held out, as neighbours are alike."""
_BESIDE_STEP_S = 0.1
"""Points this near to a step of the controller's clock are left out: their segment is unknown."""
_SEGMENT_S = 5.0
"""Duration above which a segment gets a start of its own if that of the recording does not fit."""
_BAD_START = 5.0
"""Ratio of median distances from the nominal arm above which a segment does not fit."""
_MOST_SEGMENTS = 40
_LEAST_POINTS = 50
"""Least training points of a recording."""
_FEWEST_OF_SEGMENT = 20
"""Least training points for the offset of a segment; with fewer, its held-out points are not used."""
_SPIKE_M = 0.01
"""Distance of a point from the median of its neighbours above which the start does not use it."""
_ABSURD_M = 0.05
"""Median distance of the points from the nominal arm above which the files must be wrong."""
_SEED = 0xB10C


@dataclass(frozen=True, eq=False)
class Track:
    """One recording, prepared for the fit.

    Attributes
    ----------
    name : str
    path : TimedPath
    stamps : Stamps
        Of the points.
    time_s : array, shape (m,)
        Times of the points by the tracker's clock, without its steps [s].
    p_M : array, shape (m, 3)
    sigma_m : array, shape (m,), or None
    segment : array of int, shape (m,)
        Index of the part between steps of either clock.
    clock_s : array, shape (S + 1,)
        Tracker's timestamps less those of the controller, by segment, and the rate; start values, or those of a fit.
    middle_s : float
        Timestamp at which offsets are stated.
    learnt, held_out : array of bool, shape (m,)
        Masks of training points and of held-out points; points in gaps are neither.
    start : ClockStart
    """

    name: str
    path: TimedPath = field(repr=False)
    stamps: Stamps = field(repr=False)
    time_s: Array = field(repr=False)
    p_M: Array = field(repr=False)
    sigma_m: Array | None = field(repr=False)
    segment: NDArray[np.intp] = field(repr=False)
    clock_s: Array
    middle_s: float
    learnt: NDArray[np.bool_] = field(repr=False)
    held_out: NDArray[np.bool_] = field(repr=False)
    start: ClockStart = field(repr=False)

    @property
    def learnt_s(self) -> float:
        """Time of the training points [s]."""
        return float(np.count_nonzero(self.learnt) * self.stamps.period_s)

    def controller_times(self, rows: NDArray[np.intp], clock_s: Array | None = None) -> Array:
        """Return the times of some points by the controller's clock [s], with another ``clock_s`` if given."""
        t, clock_s = self.time_s[rows], self.clock_s if clock_s is None else clock_s
        return np.asarray(t - clock_s[self.segment[rows]] - clock_s[-1] * (t - self.middle_s))


def track_of(recording: Recording, nominal: Geometry, *, tool_unknown: bool, seed: int) -> Track:
    """Prepare a recording; ``nominal`` is the chain with its tool, its base is not used.

    Raises
    ------
    InputError
        If it is at rest, the clocks do not overlap, the points do not belong to these joints, or too few are left.
    """
    where = f"recording '{recording.name}' of arm '{recording.arm}'"
    joints = recording.joints.q.shape[1]
    if joints != nominal.joints:
        raise InputError(f"{where}: {joints} joints, but the arm has {nominal.joints}")
    try:
        path, stamps = joint_path(recording.joints), read_stamps(recording.points.time_s, recording.points.p_M)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    points, time = recording.points, stamps.time_s
    p_M = points.p_M[stamps.rows]
    usual = np.linalg.norm(p_M - scipy.ndimage.median_filter(p_M, (7, 1)), axis=1) < _SPIKE_M
    start = clock_start(nominal, path, time[usual], p_M[usual], tool_unknown=tool_unknown, where=where)
    if start.rms_m > _ABSURD_M:
        raise InputError(
            f"{where}: the points lie {start.rms_m * 1e3:.0f} mm from the arm wherever its base is and whatever the"
            " delay; look for joints in degrees, points in millimetres, files of another arm or of another time,"
            " stamps that are counted at a nominal rate"
        )
    segment, near_step = _segments(path, stamps, time - start.offset_s, where)
    known = path.known(time - start.offset_s) & path.begun(time - start.offset_s) & ~near_step
    offsets = np.full(int(segment.max()) + 1, start.offset_s)
    for number in range(len(offsets)) if len(offsets) > 1 else ():
        rows = np.flatnonzero((segment == number) & usual & known)
        if _starts_elsewhere(start, path, time[rows], p_M[rows]):
            own = clock_start(nominal, path, time[rows], p_M[rows], tool_unknown=tool_unknown, where=where)
            offsets[number] = own.offset_s
    validate, guard = (
        _sampled(time, known, seed)
        if points.held_out is None
        else (points.held_out[stamps.rows], np.zeros(len(time), bool))
    )
    learnt = known & ~validate & ~guard
    if learnt.sum() < _LEAST_POINTS:
        raise InputError(
            f"{where}: {int(learnt.sum())} points lie at times at which the joints are known and are not held out; at"
            f" least {_LEAST_POINTS} are needed"
        )
    clock_known = np.bincount(segment[learnt], minlength=len(offsets)) >= _FEWEST_OF_SEGMENT
    return Track(
        recording.name,
        path,
        stamps,
        time,
        p_M,
        None if points.sigma_m is None else points.sigma_m[stamps.rows],
        segment,
        np.append(offsets, 0.0),
        float((time[0] + time[-1]) / 2.0),
        learnt,
        known & validate & clock_known[segment],
        start,
    )


def _segments(
    path: TimedPath, stamps: Stamps, controller_s: Array, where: str
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the segment of each point between steps of either clock, and a mask of points near controller steps."""
    of_joints = path.stamps.segment[path.samples_at(controller_s)]
    _, segment = np.unique(stamps.segment * (int(of_joints.max()) + 1) + of_joints, return_inverse=True)
    segment = segment.astype(np.intp)
    if segment.max() >= _MOST_SEGMENTS:
        raise InputError(
            f"{where}: its clocks jump {int(segment.max())} times; look for stamps in another unit or lines in another"
            " order"
        )
    off_s = np.subtract.outer(controller_s, [at_s for at_s, _ in path.stamps.steps])
    return segment, np.asarray(np.any(np.abs(off_s) < _BESIDE_STEP_S, axis=1))


def _starts_elsewhere(start: ClockStart, path: TimedPath, time_s: Array, p_M: Array) -> bool:
    """Return whether the points of a segment do not fit at the recording's delay: samples were lost at a step."""
    if len(time_s) < _FEWEST_OF_SEGMENT or np.ptp(time_s) < _SEGMENT_S:
        return False
    misses = np.linalg.norm(smr_positions(start.nominal, path.at(time_s - start.offset_s)[0]) - p_M, axis=1)
    return bool(np.median(misses) > _BAD_START * start.rms_m)


def _sampled(time: Array, known: NDArray[np.bool_], seed: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of the points in randomly held-out blocks of time, and of those beside such a block. The blocks
    divide the time between the first and the last point at which the joints are ``known``."""
    first, last = time[known][[0, -1]] if known.any() else time[[0, -1]]
    length = max(_SHORTEST_BLOCK_S, (last - first) / _BLOCKS)
    count = max(1, math.ceil((last - first) / length))
    chosen = np.zeros(count, dtype=bool)
    chosen[np.random.default_rng([seed, _SEED]).permutation(count)[: round(_HELD_OUT_SHARE * count)]] = True
    blocks = [
        np.clip(((time + shift - first) / length).astype(np.intp), 0, count - 1) for shift in (0.0, -_GUARD_S, _GUARD_S)
    ]
    validate, early, late = (chosen[block] for block in blocks)
    return validate, (early | late) & ~validate
