"""Instruments and other traceability data of a certificate: what was used, what is not given. No I/O."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date

from cellapp.commands.certificate.result import CertifiedArm, CertifiedInstrument
from cellapp.estimation.uncertainty.budget import MeasuredConditions, not_given
from cellapp.estimation.uncertainty.records import UncertaintyContribution
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Instrument
from cellapp.ground.times import day_of

TRACKER_ROLE = "laser tracker"
_FIELDS = {
    "model": "model",
    "serial": "serial number",
    "calibrated": "date of calibration",
    "due": "date when its calibration is due",
    "certificate": "calibration certificate",
}
"""Data that a reader expects of the tracker."""
_FIELDS_OF_OTHERS = ("serial", "calibrated", "due")
"""Data that a reader expects of an SMR and of further instruments."""


def used_instruments(profile: Profile, measured: Sequence[str]) -> tuple[CertifiedInstrument, ...]:
    """Return tracker, SMR of each arm, and further instruments; with a note if a calibration was not in force.

    ``measured`` are the first and the last time of measuring (ISO 8601); empty if unknown.
    """
    stated = profile.traceability
    days = [date.fromisoformat(day_of(time)) for time in measured]
    listed = [
        (TRACKER_ROLE, stated.tracker),
        *((f"SMR of arm {arm}", stated.smr.get(arm, Instrument())) for arm in profile.arms),
        *stated.instruments.items(),
    ]
    return tuple(
        CertifiedInstrument.like(
            one,
            role=role,
            calibrated="" if one.calibrated is None else one.calibrated.isoformat(),
            due="" if one.due is None else one.due.isoformat(),
            note=_note(one, days),
        )
        for role, one in listed
    )


def missing_data(
    profile: Profile,
    instruments: Sequence[CertifiedInstrument],
    arms: Mapping[str, CertifiedArm],
    conditions: Mapping[str, MeasuredConditions],
    measured: Sequence[str],
    contributions: Sequence[UncertaintyContribution] = (),
) -> tuple[str, ...]:
    """Name the data that a reader expects and nobody gave; ``contributions`` are those of the uncertainty."""
    stated = profile.traceability
    whole = {
        "organisation": stated.organisation,
        "client": stated.client,
        "location": stated.location,
        "operator": stated.operator,
        "procedure": stated.procedure,
        "air pressure": stated.air_pressure,
        "relative humidity": stated.relative_humidity,
    }
    named = [
        *(name for name, given in whole.items() if not given),
        *([] if measured else ["time of measuring"]),
        *(phrase for one in instruments if (phrase := _of_instrument(one))),
        *(f"uncertainty of {name}" for name in not_given(contributions)),
    ]
    for name, arm in arms.items():
        lacking = [
            *([] if arm.serial or arm.controller_serial else ["serial number of arm or controller"]),
            *([] if arm.payload_kg is not None else ["payload"]),
            *([] if arm.air_c is not None or arm.joints_c is not None else ["temperature"]),
        ]
        if lacking and name in conditions:
            named.append(f"arm {name}: {', '.join(lacking)}")
    return tuple(named)


def _of_instrument(one: CertifiedInstrument) -> str:
    expected = tuple(_FIELDS) if one.role == TRACKER_ROLE else _FIELDS_OF_OTHERS
    lacking = [_FIELDS[field] for field in expected if not getattr(one, field)]
    return f"{one.role}: {', '.join(lacking)}" if lacking else ""


def _note(one: Instrument, days: Sequence[date]) -> str:
    """Say why the calibration of an instrument was not in force on a day of measuring; empty if it was."""
    if one.due is not None and days and max(days) > one.due:
        return f"its calibration was overdue: due on {one.due}, used on {max(days)}"
    if one.calibrated is not None and days and min(days) < one.calibrated:
        return f"it was calibrated on {one.calibrated}, after it was used on {min(days)}"
    return ""
