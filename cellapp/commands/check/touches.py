"""The result of a check by touches of sockets."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cellapp.estimation.monitoring.check.model import FALSE_ALARM, MISS, SequentialState
from cellapp.estimation.monitoring.check.records import CheckedPoint, CheckedStop, CheckResult, WeakChange
from cellapp.estimation.monitoring.check.statistics import SPENT_EARLY
from cellapp.estimation.monitoring.check.touches import TouchCheck
from cellapp.estimation.readings import Readings
from cellapp.ground.results import StageName
from cellapp.robot.kinematics.transforms import xyz_of

_BEFORE = SequentialState(0, False, False, False, 0.0, 0.0, 1.0)


def touches_result(model: StageName, stale: str, found: TouchCheck, next_step: str) -> CheckResult:
    """Build the result that ``check`` stores; a stop is a touch, its point the mean of its socket by the model."""
    conclusion, stops = found.conclusion, _stops(found.readings, found)
    hidden = f"touches of these sockets cannot show: {', '.join(found.hidden)}" if found.hidden else ""
    return CheckResult(
        verdict=conclusion.verdict,
        model=model,
        planned=len(stops),
        sure_after=conclusion.sure_after,
        p_value=conclusion.p_value,
        false_alarm=FALSE_ALARM,
        miss=MISS,
        sure_change=-math.log(SPENT_EARLY * FALSE_ALARM),
        sure_valid=-math.log(SPENT_EARLY * MISS),
        arms=conclusion.arms,
        changes=conclusion.changes,
        weak=tuple(
            WeakChange(arm=one.arm, what=one.what, moved_mm=one.moved_mm, detected=one.detected, unit=one.unit)
            for one in conclusion.weak
        ),
        station_shift_mm=None,
        station_turn_deg=None,
        smr_offsets_F={name: xyz_of(offset) for name, offset in conclusion.smr_offsets_F.items()},
        stops=stops,
        stale=stale,
        next_step=next_step,
        notes=(*([hidden] if hidden else []), *conclusion.notes),
    )


def _stops(readings: Mapping[str, Readings], found: TouchCheck) -> tuple[CheckedStop, ...]:
    """Return every touch with the state of the test after it; the first touch of a socket gives no evidence."""
    standings, standing, seen = iter(found.standings), _BEFORE, set()
    stops = []
    for name, its in readings.items():
        for row, point in enumerate(its.point or ()):
            if (name, point) in seen:
                standing = next(standings)
            seen.add((name, point))
            touched = CheckedPoint(
                q=tuple(its.q[row].tolist()),
                measured_M=xyz_of(its.p_M[row]),
                error_mm=float(found.errors_m[name][row]) * 1e3,
            )
            stops.append(
                CheckedStop(
                    points={name: touched},
                    log_evidence=standing.log_evidence,
                    log_valid=standing.log_valid,
                    p_value=standing.p_value,
                    time_s=time_s if math.isfinite(time_s := float(its.time_s[row])) else 0.0,
                )
            )
    return tuple(stops)
