"""Build a certificate from the data of a run. Pure functions, no I/O: nothing is assumed that nobody gave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any

from cellapp.cell.targets.records import ArmVerification, VerifyResult
from cellapp.commands.certificate_result import (
    SIMULATED,
    CertificateResult,
    CertifiedArm,
    CertifiedCharacteristic,
    CertifiedErrors,
    CertifiedInstrument,
    CertifiedTarget,
    CertifiedTests,
)
from cellapp.commands.compensate.words import unknown_conditions
from cellapp.commands.judgements import found_in, judge_run, orientation_budget
from cellapp.commands.run_results import RunResults, evidence_of
from cellapp.estimation.iso9283.records import CommandedTests, IsoValue
from cellapp.estimation.uncertainty.budget import (
    MeasuredConditions,
    expanded_mm,
    expanded_mrad,
    not_given,
    position_budget,
)
from cellapp.estimation.uncertainty.records import Characteristic, UncertaintyContribution
from cellapp.ground.counting import counted, first_few
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Instrument
from cellapp.ground.results import CERTIFICATE, VERIFY, Record, best_method, day_of
from drivers.findings import ArmIdentity

_METHOD = (
    "Each target is driven with the command of the published geometry and with the compensated one. While the arm"
    " rests, the laser tracker measures the position of the SMR on its flange; the error is the distance from the"
    " target."
)


def certificate_of(
    profile: Profile,
    results: RunResults,
    conditions: Mapping[str, MeasuredConditions],
    controllers: Mapping[str, ArmIdentity],
    measured: tuple[str, ...],
    program: str,
    **stated: Any,
) -> CertificateResult:
    """State and judge what is known of a run, and name what is missing.

    Parameters
    ----------
    profile : Profile
        The run's profile, completed by what the operator gave.
    measured : tuple
        First and last time of measuring (ISO 8601, UTC); empty if not recorded.
    stated
        What the run does not say: number, folder, time of issue, and the files.
    """
    given = profile.traceability
    instruments = used_instruments(profile, measured)
    budgets = {
        arm: position_budget(profile, arm, evidence_of(results, arm, conditions.get(arm))) for arm in profile.arms
    }
    rotations = {arm: orientation_budget(profile, results, arm) for arm in profile.arms}
    arms = {
        arm: _arm(profile, results, arm, conditions, controllers).model_copy(
            update={"expanded_mm": expanded_mm(budgets[arm]), "expanded_mrad": expanded_mrad(rotations[arm])}
        )
        for arm in profile.arms
    }
    lines = [one.model_copy(update={"where": arm}) for arm, budget in budgets.items() for one in budget]
    return CertificateResult.like(
        given,
        **stated,
        program=program,
        measured=measured,
        profile=profile.name,
        method=f"{_METHOD} Computed by {program}.",
        air_pressure_hpa=given.air_pressure,
        relative_humidity_percent=given.relative_humidity,
        arms=arms,
        pair=_pair(results),
        instruments=instruments,
        judgements=judge_run(profile, results, conditions),
        contributions=tuple(lines),
        orientation_contributions=tuple(line for lines in rotations.values() for line in lines) or None,
        targets=_targets(results.verified),
        iso9283=_tests(results),
        limits=tuple(_limits(results, results.verified)),
        missing=missing_data(profile, instruments, arms, conditions, measured, lines),
        warnings=(
            *([f"{SIMULATED}: no real arm and no real tracker was measured"] if profile.is_simulated else []),
            *_unverified(profile, results),
            *(f"{one.role}: {one.note}" for one in instruments if one.note),
        ),
        out_of_date=tuple(f"{name}: {why}" for name, why in results.out_of_date.items() if name != CERTIFICATE),
    )


# -- figures ----------------------------------------------------------------------------------------------------------


def _arm(
    profile: Profile,
    results: RunResults,
    arm: str,
    conditions: Mapping[str, MeasuredConditions],
    controllers: Mapping[str, ArmIdentity],
) -> CertifiedArm:
    """Return what identifies an arm, the conditions of its readings, and its errors."""
    stated, controller = profile.traceability.arms.get(arm), controllers.get(arm)
    return CertifiedArm.like(
        conditions.get(arm, MeasuredConditions(readings=0)),
        type=profile.arms[arm].type.model,
        serial="" if stated is None else stated.serial,
        asset="" if stated is None else stated.asset,
        controller_model="" if controller is None else controller.model,
        controller_serial="" if controller is None else controller.serial,
        controller_software="" if controller is None else controller.software,
        errors=_errors(results, arm),
    )


def _errors(results: RunResults, arm: str) -> CertifiedErrors:
    calibrate = results.held.calibrate
    calibrated = None if calibrate is None else calibrate.arms.get(arm)
    predicted = {} if calibrated is None else calibrated.validate_
    best = None if calibrated is None else predicted[calibrated.best_stage]
    own = results.verified.arms.get(arm)
    return _found_and_left(own, predicted.get("nominal"), best, "position_mm", "orientation_mrad")


def _pair(results: RunResults) -> CertifiedErrors:
    best, nominal = (results.pair.get(method) for method in (best_method(results.pair) or "nominal", "nominal"))
    return _found_and_left(results.verified.cooperative, nominal, best, "cooperative_mm", "cooperative_mrad")


def _found_and_left(
    verified: ArmVerification | None, nominal: Record | None, best: Record | None, mm: str, mrad: str
) -> CertifiedErrors:
    """Return what was verified, and what ``nominal`` and ``best`` predict in their fields ``mm`` and ``mrad``."""
    return CertifiedErrors(
        found=getattr(verified, "nominal_mm", None),
        left=getattr(verified, "corrected_mm", None) or getattr(verified, "compensated_mm", None),
        found_mrad=getattr(verified, "nominal_mrad", None),
        left_mrad=getattr(verified, "compensated_mrad", None),
        predicted_found=getattr(nominal, mm, None),
        predicted_left=getattr(best, mm, None),
        predicted_found_mrad=getattr(nominal, mrad, None),
        predicted_left_mrad=getattr(best, mrad, None),
    )


def _targets(verify: VerifyResult) -> tuple[CertifiedTarget, ...]:
    return tuple(
        CertifiedTarget.like(
            one,
            found_mm=one.nominal_mm,
            left_mm=one.final_mm,
            found_mrad=None if one.orientation is None else one.orientation.nominal_mrad,
            left_mrad=None if one.orientation is None else one.orientation.final_mrad,
        )
        for one in verify.targets
    )


def _tests(results: RunResults) -> CertifiedTests | None:
    """Return the largest value of each characteristic that the test by ISO 9283 measured, while it holds."""
    tested = results.held.iso9283
    if tested is None:
        return None
    return CertifiedTests(
        characteristics=tuple(
            CertifiedCharacteristic.like(largest, where=name, characteristic=characteristic, commands=kind)
            for name, arm in tested.arms.items()
            for kind, made in arm.tests.items()
            for characteristic, largest in _largest(made).items()
        ),
        cycles=None if tested.conditions is None else tested.conditions.cycles,
        speed_share=None if tested.conditions is None else tested.conditions.speed_share,
        payload_kg={name: arm.payload_kg for name, arm in tested.arms.items()},
        missing=(*([tested.stopped] if tested.stopped else []), *tested.missing),
        coverage=tested.coverage,
    )


def _largest(tests: CommandedTests) -> dict[Characteristic, IsoValue]:
    measured = grouped((one.characteristic, one.value) for one in found_in(tests))
    return {name: max(found, key=lambda one: abs(one.value_mm)) for name, found in measured.items()}


# -- words ------------------------------------------------------------------------------------------------------------


def _unverified(profile: Profile, results: RunResults) -> list[str]:
    if VERIFY in results.out_of_date:
        why = results.out_of_date[VERIFY]
        return [f"not verified: the verification is out of date ({why}); its figures are left out"]
    verify = results.verified
    if not verify.arms:
        return ["not verified: no compensated target was measured; the figures are predictions"]
    return [
        *([f"the verification is not complete: {verify.stopped}"] if verify.stopped else []),
        *(f"arm {arm}: not verified" for arm in profile.arms if arm not in verify.arms),
    ]


def _limits(results: RunResults, verify: VerifyResult) -> list[str]:
    """Say for what the as-left figures hold, and what they do not cover."""
    if not verify.arms:
        return []
    sentences = [
        "The as-left figures are of the verified targets; payload and temperatures are those of the calibration's"
        " readings."
    ]
    for arm in dict.fromkeys(target.arm for target in verify.targets):
        own = verify.of_arm(arm)
        if missing := [target.name for target in own if target.final_mm is None]:
            count = counted(len(own), "target was", "targets were")
            sentences.append(f"Arm {arm}: {len(missing)} of {count} not measured: {', '.join(first_few(missing))}.")
        corrected = sum(target.corrected_mm is not None for target in own)
        if corrected:
            sentences.append(
                f"Arm {arm}: {corrected} of {counted(len(own), 'target was', 'targets were')} corrected by"
                " measuring them."
            )
        sentences += _conditions(results, arm)
    return sentences


def _conditions(results: RunResults, arm: str) -> list[str]:
    """State the working conditions of the commands, and by how much other conditions move the SMR."""
    return [
        f"Arm {arm}: verified with the {one.condition} that the commands are made for; with another one the SMR may be"
        f" elsewhere by up to {one.mm:.3f} mm ({', '.join(one.effects).replace('_', ' ')})."
        for one in unknown_conditions([command for command in results.commands if command.arm == arm])
    ]


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
