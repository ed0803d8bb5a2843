"""Pulses of a hardware trigger, timestamped by the controller that sends them and by the tracker that receives them.

A controller timestamps the control cycle in which its output rose, but not the time within it. The tracker's timestamps
are accurate to microseconds. So pulses give the offset to within a cycle, and select among delays that a repeating
motion fits alike. The motion itself determines the offset better; the pulses check it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellapp.robot.kinematics.transforms import Array

_FEWEST = 3
_ALIKE_S = 0.012
"""Tolerance within which differences of timestamps belong to the same delay."""
_MOST_PPM = 200.0
_RATE_FROM_S = 30.0
"""Time span above which pulses determine the rate as well."""
_SIGMAS = 3.0


@dataclass(frozen=True)
class TriggeredClock:
    """Offset of the tracker's timestamps from the controller's by some pulses, and its standard error [s]."""

    offset_s: float
    standard_error_s: float
    pulses: int


@dataclass(frozen=True)
class TriggerCheck:
    """Offset by the trigger compared with that of the motion: ``difference_s`` is the motion's less the trigger's."""

    offset_s: float
    standard_error_s: float
    pulses: int
    difference_s: float
    agrees: bool


def triggered_clock(controller_s: Array, tracker_s: Array, at_s: float, period_s: float) -> TriggeredClock | None:
    """Compute the offset at the tracker's timestamp ``at_s`` from pulses (k,) and (l,), some of them missing.

    ``period_s`` is the controller's cycle. None if too few pulses match.
    """
    pairs = _pairs(np.sort(controller_s), np.sort(tracker_s))
    if pairs is None:
        return None
    stamps, offsets = pairs
    rate = 0.0
    if np.ptp(stamps) > _RATE_FROM_S:
        rate = float(np.clip(np.polyfit(stamps - at_s, offsets, 1)[0], -_MOST_PPM * 1e-6, _MOST_PPM * 1e-6))
    there = offsets - rate * (stamps - at_s)
    error_s = math.hypot(float(np.std(there, ddof=1)) / math.sqrt(len(there)), period_s / math.sqrt(3.0))
    return TriggeredClock(float(np.median(there)), error_s, len(there))


def checked(trigger: TriggeredClock | None, offset_s: float, standard_error_s: float) -> TriggerCheck | None:
    """Compare with the offset of the motion at the same timestamp; None without a trigger."""
    if trigger is None:
        return None
    difference_s = offset_s - trigger.offset_s
    allowed_s = _SIGMAS * math.hypot(trigger.standard_error_s, standard_error_s)
    return TriggerCheck(
        trigger.offset_s, trigger.standard_error_s, trigger.pulses, difference_s, abs(difference_s) <= allowed_s
    )


def _pairs(controller_s: Array, tracker_s: Array) -> tuple[Array, Array] | None:
    """Return the tracker's timestamps (n,) and their differences from the controller's (n,) of matching pulses."""
    if min(len(controller_s), len(tracker_s)) < _FEWEST:
        return None
    differences = tracker_s[:, None] - controller_s[None, :]
    span_s = max(float(np.ptp(controller_s)), float(np.ptp(tracker_s)))
    within_s = _ALIKE_S + _MOST_PPM * 1e-6 * span_s
    ordered = np.sort(differences, axis=None)
    count = np.searchsorted(ordered, ordered + within_s, side="right") - np.arange(len(ordered))
    first = ordered[int(np.argmax(count))]
    there = (differences >= first - 1e-12) & (differences <= first + within_s)
    away = np.where(there, np.abs(differences - np.median(differences[there])), np.inf)
    rows, columns = np.arange(len(away)), np.argmin(away, axis=1)  # mutual nearest neighbours only
    own = np.isfinite(away[rows, columns]) & (np.argmin(away, axis=0)[columns] == rows)
    rows, columns = rows[own], columns[own]
    return None if len(rows) < _FEWEST else (tracker_s[rows], differences[rows, columns])
