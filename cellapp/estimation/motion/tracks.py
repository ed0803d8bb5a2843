"""Preparation of a recording for the fit: joint path, points, clock segments, held-out blocks, start."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.motion.clock_start import ClockStart, clock_start, start_by_trigger
from cellapp.estimation.motion.joint_path import JointPath, joint_path
from cellapp.estimation.motion.stamps import Stamps, read_stamps
from cellapp.estimation.motion.streams import Recording
from cellapp.estimation.motion.triggers import TriggeredClock, triggered_clock
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array

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
    path : JointPath
    stamps : Stamps
        Of the points.
    time_s : array, shape (m,)
        Times of the points by the tracker's clock, without its steps [s].
    p_M : array, shape (m, 3)
    sigma_m : array, shape (m,), or None
    segment : array of int, shape (m,)
        Index of the part between steps of either clock.
    offsets_s : array, shape (S,)
        Start values: tracker's timestamps less those of the controller, by segment.
    middle_s : float
        Timestamp at which offsets are stated.
    learnt, held_out : array of bool, shape (m,)
        Masks of training points and of held-out points; points in gaps are neither.
    start : ClockStart
    trigger : TriggeredClock or None
        Offset from pulses of a hardware trigger at ``middle_s``.
    """

    name: str
    path: JointPath = field(repr=False)
    stamps: Stamps = field(repr=False)
    time_s: Array = field(repr=False)
    p_M: Array = field(repr=False)
    sigma_m: Array | None = field(repr=False)
    segment: NDArray[np.intp] = field(repr=False)
    offsets_s: Array
    middle_s: float
    learnt: NDArray[np.bool_] = field(repr=False)
    held_out: NDArray[np.bool_] = field(repr=False)
    start: ClockStart = field(repr=False)
    trigger: TriggeredClock | None = field(default=None, repr=False)

    def controller_times(self, rows: NDArray[np.intp], offsets_s: Array, rate: float) -> Array:
        """Return the times of some points by the controller's clock [s]."""
        t = self.time_s[rows]
        return np.asarray(t - offsets_s[self.segment[rows]] - rate * (t - self.middle_s))


def track_of(recording: Recording, nominal: Geometry, *, tool_unknown: bool, seed: int) -> Track:
    """Prepare a recording; ``nominal`` is the chain with its tool, its base is not used.

    Raises
    ------
    InputError
        If it is at rest, the clocks do not overlap, or the points do not belong to these joints.
    """
    where = f"recording '{recording.name}' of arm '{recording.arm}'"
    try:
        path, stamps = joint_path(recording.joints), read_stamps(recording.points.time_s, recording.points.p_M)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    points, time = recording.points, stamps.time_s
    p_M = points.p_M[stamps.rows]
    usual = np.linalg.norm(p_M - scipy.ndimage.median_filter(p_M, (7, 1)), axis=1) < _SPIKE_M
    start = clock_start(nominal, path, time[usual], p_M[usual], tool_unknown=tool_unknown, where=where)
    trigger = None
    if not stamps.steps and not path.stamps.steps:
        middle_s, period_s = float((time[0] + time[-1]) / 2.0), float(np.median(np.diff(path.stamps.time_s)))
        trigger = triggered_clock(recording.joints.triggers_s, points.triggers_s, middle_s, period_s)
    if trigger is not None:
        start = start_by_trigger(
            start, trigger.offset_s, nominal, path, time[usual], p_M[usual], tool_unknown=tool_unknown
        )
    if start.rms_m > _ABSURD_M:
        raise InputError(
            f"{where}: the points lie {start.rms_m * 1e3:.0f} mm from the arm wherever its base is and whatever the"
            " delay; look for joints in degrees, points in millimetres, files of another arm or of another time,"
            " stamps that are counted at a nominal rate"
        )
    segment, beside = _segments(path, stamps, time - start.offset_s, where)
    known = path.known(time - start.offset_s) & path.begun(time - start.offset_s) & ~beside
    held_out = points.held_out
    track = Track(
        recording.name,
        path,
        stamps,
        time,
        p_M,
        None if points.sigma_m is None else points.sigma_m[stamps.rows],
        segment,
        np.full(int(segment.max()) + 1, start.offset_s),
        float((time[0] + time[-1]) / 2.0),
        known,
        known,
        start,
        trigger,
    )
    track = _with_segment_starts(track, usual & known, nominal, tool_unknown, where)
    validate, guard = (
        _drawn(time, known, seed) if held_out is None else (held_out[stamps.rows], np.zeros(len(time), bool))
    )
    learnt = known & ~validate & ~guard
    clock_known = np.bincount(segment[learnt], minlength=len(track.offsets_s)) >= _FEWEST_OF_SEGMENT
    return replace(track, learnt=learnt, held_out=known & validate & clock_known[segment])


def _segments(
    path: JointPath, stamps: Stamps, controller_s: Array, where: str
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the segment of each point between steps of either clock, and a mask of points near controller steps."""
    of_joints = path.segment_at(controller_s)
    _, segment = np.unique(stamps.segment * (int(of_joints.max()) + 1) + of_joints, return_inverse=True)
    segment = segment.astype(np.intp)
    if segment.max() >= _MOST_SEGMENTS:
        raise InputError(
            f"{where}: its clocks jump {int(segment.max())} times; look for stamps in another unit or lines in another"
            " order"
        )
    beside = np.zeros(len(segment), dtype=bool)
    for step in path.stamps.steps:
        beside |= np.abs(controller_s - step.at_s) < _BESIDE_STEP_S
    return segment, beside


def _with_segment_starts(
    track: Track, usual: NDArray[np.bool_], nominal: Geometry, tool_unknown: bool, where: str
) -> Track:
    """Give segments that do not fit at the recording's delay their own start: samples were lost at a step."""
    offsets = track.offsets_s.copy()
    if len(offsets) == 1:
        return track
    for number in range(len(offsets)):
        rows = np.flatnonzero((track.segment == number) & usual)
        if len(rows) < 20 or np.ptp(track.time_s[rows]) < _SEGMENT_S:
            continue
        q, _ = track.path.at(track.time_s[rows] - offsets[number])
        misses = np.linalg.norm(smr_positions(track.start.nominal, q) - track.p_M[rows], axis=1)
        if np.median(misses) > _BAD_START * track.start.rms_m:
            own = clock_start(
                nominal, track.path, track.time_s[rows], track.p_M[rows], tool_unknown=tool_unknown, where=where
            )
            offsets[number] = own.offset_s
    return replace(track, offsets_s=offsets)


def _drawn(time: Array, known: NDArray[np.bool_], seed: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
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
