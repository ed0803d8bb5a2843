"""Columns of recordings: their names, checks of plausibility, and their conversion to objects for estimation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.column_names import Kind
from cellapp.cell.run.records import StreamState
from cellapp.cell.run.written_orientation import QUATERNION
from cellapp.estimation.motion.streams import JointStream, PointStream
from cellapp.estimation.readings.columns import COLUMNS, Fault, beyond_limits

Columns = Mapping[str, NDArray[np.float64]]
"""Columns of a stream by their names in a CSV file, each (n,)."""

TEXTS = ("recording", "arm", "split")
POINT = ("x_m", "y_m", "z_m")
TRIGGER = "trigger_s"
"""Timestamp of a pulse from the controller to the tracker, by the device's own clock, in the row nearest to it."""
OPTIONAL_OF_JOINTS = ("qd", "joint_temperature")
BESIDE = "other_q"
"""Joint positions of the other arm of the cell, if it moved meanwhile."""

_CHECKS = {name: column.check for column in COLUMNS for name in (column.csv[0],) if column.check is not None}
_LEAST_ROWS = 20
_SLOWEST_HZ, _FASTEST_HZ = 2.0, 20_000.0
"""Plausible sampling rates [Hz]; outside these, timestamps are not in seconds."""
UNITS_OF_TIME = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_COLUMNS_OF_TIME = {"milliseconds": "time_ms", "microseconds": "time_us", "nanoseconds": "time_ns"}
_USUAL_STEP_S = (5e-4, 0.05)
"""Plausible steps of recordings [s], a factor of 100 apart: at most one unit puts a step between them."""
_DEGREES = "degrees? Then name the columns q1_deg, q2_deg, ..."
_FASTEST_RAD_S = 12.0
"""Upper limit of joint speeds [rad/s]: no joint of an industrial arm is faster."""
_REST_RAD, _REST_M = 1e-3, 2e-3
"""Ranges of joints and of the point within which an arm does not move."""
_UNIT = 1e-3
"""Largest deviation of a quaternion's length from one."""
_GAP = 2.5
"""Multiple of the median step of the timestamps from which on a step is a gap."""


@dataclass(frozen=True)
class Implausible:
    """What is wrong in a stream: row (None: the whole file), column, and what was expected."""

    row: int | None
    column: str
    text: str


def stems(kind: Kind, joints: int, others: int = 0) -> dict[str, tuple[str, ...]]:
    """Return quantity -> its columns; the first two of a kind are required. ``others``: joints of the other arm."""
    if kind == "points":
        points = {"time_s": ("time_s",), "p_M": POINT, "sigma_m": ("sigma_m",), "quaternion": QUATERNION}
        return {**points, "trigger": (TRIGGER,)}
    per_joint = {stem: tuple(f"{stem}{j}" for j in range(1, joints + 1)) for stem in ("q", *OPTIONAL_OF_JOINTS)}
    beside = tuple(f"{BESIDE}{j}" for j in range(1, others + 1))
    return {"time_s": ("time_s",), **per_joint, BESIDE: beside, "trigger": (TRIGGER,)}


def state_of(time_s: NDArray[np.float64], lost: int = 0) -> StreamState:
    """Summarise the timestamps of a stream, in the order in which they were recorded."""
    step = np.diff(time_s)
    forward = step[step > 0.0]
    median = float(np.median(forward)) if len(forward) else math.inf
    gaps = step[step > _GAP * median]
    return StreamState(
        n=len(time_s),
        seconds=float(np.ptp(time_s)),
        rate_hz=1.0 / median,
        gaps=len(gaps),
        longest_gap_s=float(gaps.max(initial=0.0)),
        repeats=int(np.count_nonzero(step == 0.0)),
        backward=int(np.count_nonzero(step < 0.0)),
        lost=lost,
    )


def time_unit(stamps: NDArray[np.float64]) -> str | None:
    """Return the unit of timestamps by the median step between them; None if no unit gives a plausible step."""
    step = np.diff(stamps)
    usual = float(np.median(step[step > 0.0])) if (step > 0.0).any() else 0.0
    least, most = _USUAL_STEP_S
    return next((unit for unit, factor in UNITS_OF_TIME.items() if least <= usual * factor <= most), None)


def joint_faults(columns: Columns, limits: NDArray[np.float64], *, dated: bool = False) -> Iterator[Implausible]:
    """Yield what is implausible in samples of an arm whose joints have these ``limits`` (N, 2) [rad].

    ``dated``: the timestamps are dates or times of day in the file, so that their unit is certain.
    """
    names = stems("joints", len(limits))
    q = _matrix(columns, names["q"])
    wrong = [*_stamp_faults(columns["time_s"], dated), *_missing(columns, names["q"]), *_missing(columns, names["qd"])]
    beyond = beyond_limits(q, limits, _DEGREES)
    wrong += [Implausible(one.row, f"q{(one.place or 0) + 1}", one.text) for one in beyond]
    yield from wrong
    if wrong:
        return
    step = np.diff(columns["time_s"])
    moving = step > 0.5 * np.median(step[step > 0.0])
    speed = np.abs(np.diff(q, axis=0)[moving] / step[moving, np.newaxis])
    fast = np.quantile(speed, 0.95, axis=0)
    joint = int(np.argmax(fast))
    if fast[joint] > _FASTEST_RAD_S:
        text = f"the joint turns at {fast[joint]:.3g} rad/s; expected radians and seconds; {_DEGREES}"
        yield Implausible(None, f"q{joint + 1}", text)
    if float(np.ptp(q, axis=0).max()) < _REST_RAD:
        yield Implausible(None, "q1..", f"no joint moves by {_REST_RAD:g} rad; expected a recording of a motion")
    if names["qd"][0] in columns:
        yield from _speed_unit(columns, names["qd"], q)


def beside_faults(columns: Columns, limits: NDArray[np.float64]) -> Iterator[Implausible]:
    """Yield what is implausible in joint positions of the other arm, whose joints have these ``limits`` (K, 2) [rad];
    rows without any are allowed: it was not recorded then."""
    names = tuple(f"{BESIDE}{joint}" for joint in range(1, len(limits) + 1))
    if not names or not all(name in columns for name in names):
        return
    q = _matrix(columns, names)
    unknown = np.isnan(q)
    partly = np.flatnonzero(unknown.any(axis=1) & ~unknown.all(axis=1))
    if len(partly):
        text = "the value is missing; give all joints of the other arm in a row, or none"
        yield Implausible(int(partly[0]), names[int(np.argmax(unknown[partly[0]]))], text)
    for one in beyond_limits(q, limits):
        yield Implausible(one.row, names[one.place or 0], one.text)


def point_faults(columns: Columns, *, dated: bool = False) -> Iterator[Implausible]:
    """Yield what is implausible in points; ``dated`` as in ``joint_faults``."""
    yield from _stamp_faults(columns["time_s"], dated)
    yield from _missing(columns, ("sigma_m", *QUATERNION))
    p = _matrix(columns, POINT)
    for stem, matrix in (("x_m", p), ("sigma_m", _matrix(columns, ("sigma_m",)))):
        names: tuple[str, ...] = POINT if stem == "x_m" else ("sigma_m",)
        check = _CHECKS[stem]
        fault: Fault | None = check(matrix) if names[0] in columns else None
        if fault is not None:
            hint = "; if these are millimetres, name the columns x_mm, y_mm, z_mm" if stem == "x_m" else ""
            yield Implausible(fault.row, names[fault.place or 0], fault.text + hint)
    if QUATERNION[0] in columns:
        length = np.linalg.norm(_matrix(columns, QUATERNION), axis=1)
        wrong = np.flatnonzero(np.abs(length - 1.0) > _UNIT)
        if len(wrong):
            text = f"expected a quaternion of length 1, got {length[wrong[0]]:.4g}; correct them, or leave them out"
            yield Implausible(int(wrong[0]), QUATERNION[0], text)
    if len(p) and float(np.ptp(p, axis=0).max()) < _REST_M:
        yield Implausible(None, "x_m", f"the SMR does not move by {_REST_M * 1e3:g} mm; expected points of a motion")


def joint_stream(columns: Columns, joints: int) -> JointStream:
    """Convert the samples of an arm for estimation."""
    names = stems("joints", joints)
    optional = {
        stem: _matrix(columns, names[stem]) for stem in OPTIONAL_OF_JOINTS if names[stem][0] in columns
    }  # each has all joints or none: checked on import
    beside = [name for name in columns if name.startswith(BESIDE)]
    return JointStream(
        time_s=columns["time_s"],
        q=_matrix(columns, names["q"]),
        triggers_s=_pulses(columns),
        other_q=_matrix(columns, tuple(beside)) if beside else None,
        **optional,
    )


def point_stream(columns: Columns, splits: tuple[str, ...] | None) -> PointStream:
    """Convert the points for estimation; ``splits`` are the texts to which the codes in column ``split`` refer."""
    held_out = None
    if splits is not None and any(splits):
        held_out = columns["split"] == (splits.index("validate") if "validate" in splits else math.inf)
    return PointStream(
        time_s=columns["time_s"],
        p_M=_matrix(columns, POINT),
        sigma_m=columns.get("sigma_m"),
        quaternion=_matrix(columns, QUATERNION) if QUATERNION[0] in columns else None,
        held_out=held_out,
        triggers_s=_pulses(columns),
    )


def _pulses(columns: Columns) -> NDArray[np.float64]:
    """Return the timestamps of pulses (k,) in a stream; none without a trigger."""
    stamps = columns.get(TRIGGER, np.empty(0))
    return stamps[np.isfinite(stamps)]


def pulse_column(time_s: NDArray[np.float64], pulses_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a column with each pulse's timestamp (k,) in its nearest free row of ``time_s`` (n,), else NaN."""
    column = np.full(len(time_s), np.nan)
    for pulse in pulses_s.tolist():
        free = np.flatnonzero(np.isnan(column))
        column[free[np.argmin(np.abs(time_s[free] - pulse))]] = pulse
    return column


def _matrix(columns: Columns, names: tuple[str, ...]) -> NDArray[np.float64]:
    return np.column_stack([columns[name] for name in names if name in columns] or [np.empty((0, 0))])


def _missing(columns: Columns, names: tuple[str, ...]) -> Iterator[Implausible]:
    """Yield the first empty cell of each of these columns, which every row must have."""
    for name in names:
        rows = np.flatnonzero(np.isnan(columns[name])) if name in columns else np.empty(0, np.intp)
        if len(rows):
            yield Implausible(int(rows[0]), name, "the value is missing; give it in every row, or leave the column out")


def _stamp_faults(time_s: NDArray[np.float64], dated: bool) -> Iterator[Implausible]:
    if len(time_s) < _LEAST_ROWS:
        yield Implausible(None, "time_s", f"{len(time_s)} rows are no recording of a motion; expected {_LEAST_ROWS}")
        return
    step = np.diff(time_s)
    forward = step[step > 0.0]
    if len(forward) < len(step) // 2:
        yield Implausible(None, "time_s", "most stamps do not increase; expected the times at which samples were taken")
        return
    rate = 1.0 / float(np.median(forward))
    if not _SLOWEST_HZ <= rate <= _FASTEST_HZ:
        text = f"the median step is {1.0 / rate:.3g}; expected seconds, {_SLOWEST_HZ:g} to {_FASTEST_HZ:g} samples each"
        unit = None if dated else time_unit(time_s)
        hint = "" if unit is None else f"; are these {unit}? Then name the column {_COLUMNS_OF_TIME[unit]}"
        yield Implausible(None, "time_s", text + hint)


def _speed_unit(columns: Columns, names: tuple[str, ...], q: NDArray[np.float64]) -> Iterator[Implausible]:
    """Check that speeds agree with the joint positions: in rad/s, not in degrees per second."""
    qd = _matrix(columns, names)
    step = np.diff(columns["time_s"])
    steady = (step > 0.0) & (step < _GAP * np.median(step[step > 0.0]))
    turned = np.diff(q, axis=0)[steady]
    by_speed = 0.5 * (qd[1:] + qd[:-1])[steady] * step[steady, np.newaxis]
    ratio = math.sqrt(float((by_speed**2).sum()) / max(float((turned**2).sum()), 1e-300))
    if not 0.1 < ratio < 10.0 and ratio > 0.0:
        hint = "; are these degrees a second? Then name the columns qd1_deg, ..." if 40.0 < ratio < 80.0 else ""
        yield Implausible(None, "qd1", f"the speeds are {ratio:.3g} times those of q1..; expected rad/s{hint}")
