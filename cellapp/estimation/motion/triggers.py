"""Pulses of a hardware trigger: stamped by the controller that gave them and by the tracker that got them.

A controller stamps the control cycle in which its output rose; when in it, is not known. The tracker's stamps are good
to microseconds. So pulses tell the offset to a cycle, and tell apart delays at which a motion that repeats fits alike;
the motion itself tells it better, and the pulses check it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellapp.robot.kinematics.transforms import Array

_FEWEST = 3
_ALIKE_S = 0.012
"""Differences of stamps this near belong to the same delay."""
_MOST_PPM = 200.0
_RATE_FROM_S = 30.0
"""Pulses this far apart tell the rate as well."""
_SIGMAS = 3.0


@dataclass(frozen=True)
class TriggeredClock:
    """Offset of the tracker's stamps against the controller's by some pulses, and its standard error [s]."""

    offset_s: float
    standard_error_s: float
    pulses: int


@dataclass(frozen=True)
class TriggerCheck:
    """The offset by the trigger beside that of the motion: ``difference_s`` is the motion's less the trigger's."""

    offset_s: float
    standard_error_s: float
    pulses: int
    difference_s: float
    agrees: bool


def triggered_clock(controller_s: Array, tracker_s: Array, at_s: float, period_s: float) -> TriggeredClock | None:
    """The offset at the tracker's stamp ``at_s`` by pulses (k,) and (l,), some of which may be missing on either side.

    ``period_s`` is the controller's cycle. None where too few pulses belong together.
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
    """Compare with the offset of the motion at the same stamp."""
    if trigger is None:
        return None
    difference_s = offset_s - trigger.offset_s
    allowed_s = _SIGMAS * math.hypot(trigger.standard_error_s, standard_error_s)
    return TriggerCheck(
        trigger.offset_s, trigger.standard_error_s, trigger.pulses, difference_s, abs(difference_s) <= allowed_s
    )


def _pairs(controller_s: Array, tracker_s: Array) -> tuple[Array, Array] | None:
    """Stamps of the tracker (n,) and their differences from the controller's (n,), of pulses that belong together."""
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
    rows, columns = np.arange(len(away)), np.argmin(away, axis=1)  # the nearest one of each, and that of no other
    own = np.isfinite(away[rows, columns]) & (np.argmin(away, axis=0)[columns] == rows)
    rows, columns = rows[own], columns[own]
    return None if len(rows) < _FEWEST else (tracker_s[rows], differences[rows, columns])
