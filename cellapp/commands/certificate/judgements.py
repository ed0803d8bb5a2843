"""Judgements of a run against the tolerances of its profile. Pure functions, no I/O.

Only measurements after compensation are judged: the newest verification that holds. ``position`` is the largest
distance of an arm's SMR from its targets, ``distance`` the largest error of the distance between any two verified
targets of an arm, ``orientation`` the largest angle of its flange from the wanted rotation where a probe measured it,
``cooperative`` the largest error of the distance between the SMRs of two arms, ``cooperative_orientation`` the largest
angle of one flange in the other's frame from the wanted one. Without a verification nothing is
decided; ``source`` then states the calibration's held-out error, which is a prediction. The characteristics of ISO 9283
are those that its test measured. After a check that found changed arms, no earlier measurement decides anything.

Characteristics of ISO 9283 against the tolerances of a profile: each arm's worst pose decides.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy

from cellapp.cell.targets.records import MeasuredPair, MeasuredTarget, VerifyResult
from cellapp.commands.run_results import RunResults, evidence_of
from cellapp.estimation.iso9283.norm import (
    ISO_COMMANDS,
    NORM_CYCLES,
    NORM_DRIFT_MIN,
    IsoCommands,
    IsoTest,
    wanted_cycles,
)
from cellapp.estimation.iso9283.records import ArmIso9283, CommandedTests, IsoValue, PairIso9283
from cellapp.estimation.uncertainty.budget import (
    MeasuredConditions,
    angle_budget,
    conformity,
    distance_budget,
    expanded_mm,
    expanded_mrad,
    not_given,
    position_budget,
)
from cellapp.estimation.uncertainty.records import AngleContribution, Characteristic, Judgement, UncertaintyContribution
from cellapp.ground.counting import counted
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Tolerances
from cellapp.ground.results import CALIBRATE, ISO9283, VERIFY, ErrorSummary, StageName, best_method

Budget = Sequence[UncertaintyContribution]
_ROTATIONS: tuple[Characteristic, ...] = ("orientation", "cooperative_orientation")
"""Characteristics in mrad; all others are in mm."""


@dataclass(frozen=True)
class _Measured:
    """Errors [mm] of one characteristic; where, from which source, and the contributions to their uncertainty."""

    characteristic: Characteristic
    where: str
    errors_mm: Sequence[float]
    source: str
    budget: Budget = ()


def judge_run(
    profile: Profile, results: RunResults, measured: Mapping[str, MeasuredConditions] | None = None
) -> tuple[Judgement, ...]:
    """Judge the results of a run by the tolerances of a profile; empty if it gives none.

    Parameters
    ----------
    measured : mapping, optional
        Conditions of the readings by arm, for the temperature's contribution to the uncertainty.
    """
    if not profile.tolerances.any_given:
        return ()
    conditions = measured or {}
    budgets = {
        arm: position_budget(profile, arm, evidence_of(results, arm, conditions.get(arm))) for arm in profile.arms
    }
    own = [
        *(_position(results, arm, budget) for arm, budget in budgets.items()),
        *(_distance(results, arm, budget) for arm, budget in budgets.items()),
        *_cooperative(profile.tolerances, results, budgets),
    ]
    judged = [*(_judged(profile.tolerances, one) for one in own), *_orientations(profile, results)]
    changed = other_arms_found(results)
    return tuple(_undecided(one, changed) for one in (*judged, *_iso(profile, results)) if one is not None)


# -- what was measured ------------------------------------------------------------------------------------------------


def _position(results: RunResults, arm: str, budget: Budget) -> _Measured:
    verify, targets = results.verified, results.verified.of_arm(arm)
    errors = [one.final_mm for one in targets if one.final_mm is not None]
    if not errors:
        return _Measured("position", arm, (), _unverified(results, "position", _held_out(results, arm, "position_mm")))
    return _Measured("position", arm, errors, _verified(verify, len(errors), len(targets), "targets"), budget)


def _distance(results: RunResults, arm: str, budget: Budget) -> _Measured:
    """Collect all pairs of verified targets with compensated commands; a corrected target has no measured position."""
    verify, targets = results.verified, results.verified.of_arm(arm)
    errors = _distance_errors_mm(targets)
    if not errors:
        return _Measured("distance", arm, (), _unverified(results, "distance", _held_out(results, arm, "distance_mm")))
    points = sum(one.measured_M is not None for one in targets)
    source = f"{_verified(verify, points, len(targets), 'targets')}, {counted(len(errors), 'distance')} between them"
    return _Measured("distance", arm, errors, source, distance_budget(budget))


def _cooperative(tolerances: Tolerances, results: RunResults, budgets: Mapping[str, Budget]) -> list[_Measured]:
    """Collect each pair of arms with verified cooperative targets; also the only pair of a cell without any."""
    verify = results.verified
    found = grouped((pair.arms, pair.final_mm) for pair in verify.pairs if pair.final_mm is not None)
    if found:
        return [
            _Measured(
                "cooperative",
                _both(arms),
                errors,
                _verified(verify, len(errors), sum(one.arms == arms for one in verify.pairs), "pairs of targets"),
                [one for arm in arms for one in budgets[arm]],
            )
            for arms, errors in found.items()
        ]
    tested = any(one.characteristic == "cooperative" for one in _held_iso(tolerances, results))
    if len(budgets) != 2 or tested:
        return []
    best = best_method(results.pair)
    held_out = None if best is None else results.pair[best].cooperative_mm
    return [_Measured("cooperative", _both(list(budgets)), (), _unverified(results, "cooperative", held_out))]


def _orientations(profile: Profile, results: RunResults) -> Iterator[Judgement]:
    """Yield each probe arm's largest error of orientation at verified targets; of every arm if none has a probe.

    Then that of one flange in the other's frame.
    """
    verify = results.verified
    probed = [name for name, arm in profile.arms.items() if arm.smr.probe is not None]
    for arm in probed or profile.arms:
        yield from _rotated(profile, results, "orientation", (arm,), verify.of_arm(arm), arm in probed)
    if len(profile.arms) == 2:
        names = tuple(profile.arms)
        yield from _rotated(profile, results, "cooperative_orientation", names, verify.pairs, len(probed) == 2)


def _rotated(
    profile: Profile,
    results: RunResults,
    characteristic: Literal["orientation", "cooperative_orientation"],
    arms: tuple[str, ...],
    measured: Sequence[MeasuredTarget | MeasuredPair],
    probed: bool,
) -> Iterator[Judgement]:
    """Yield the judgement of an arm's orientation, or of one flange in the other's frame, if it has a tolerance."""
    angles = [its.final_mrad for one in measured if (its := one.orientation) and its.final_mrad is not None]
    value = max(angles, default=None)
    if angles:
        what = "targets" if len(arms) == 1 else "pairs of targets"
        source = _verified(results.verified, len(angles), len(measured), what)
    elif probed:
        source = _unverified(results, characteristic, _held_out_rotations(results, arms), "mrad")
    else:
        source = f"not measured: {'the' if len(arms) == 1 else 'a'} flange has no 6-D probe (smr.probe)"
    budgets = [orientation_budget(profile, results, arm) for arm in arms]
    expanded = None if value is None or not all(budgets) else expanded_mrad([one for own in budgets for one in own])
    judged = _judgement(profile.tolerances, characteristic, _both(arms), value, expanded, source, len(angles))
    yield from () if judged is None else (judged,)


def orientation_budget(profile: Profile, results: RunResults, arm: str) -> tuple[AngleContribution, ...]:
    """Return the contributions to an arm's uncertainty of orientation, at the command with the model's largest one;
    empty if no orientation was predicted."""
    rotations = [one.orientation for one in results.commands if one.arm == arm and one.orientation is not None]
    if not rotations:
        return ()
    worst = max(rotations, key=lambda one: one.model_mrad)
    basis = f"largest of {counted(len(rotations), 'command')}"
    return angle_budget(profile, arm, worst.model_mrad, worst.noise_mrad, basis)


def _iso(profile: Profile, results: RunResults) -> list[Judgement | None]:
    """Return the judgements of measured characteristics, and those with a tolerance that were not measured."""
    held = _held_iso(profile.tolerances, results)
    why = _outdated(results, ISO9283, "the test by ISO 9283") or "not measured"
    return [
        *held,
        *(
            _judged(profile.tolerances, _Measured(name, arm, (), why))
            for name in TEST_OF
            for arm in profile.arms
            if not any(one.characteristic == name and one.where == arm for one in held)
        ),
    ]


# -- inside -----------------------------------------------------------------------------------------------------------


def _judged(tolerances: Tolerances, one: _Measured) -> Judgement | None:
    """Judge the largest error; None if the profile gives no tolerance."""
    value = max(one.errors_mm, default=None)
    expanded = expanded_mm(one.budget) if value is not None else None
    missing = not_given(one.budget) if value is not None else []
    unknown = f"; uncertainty not known, as not given: {', '.join(missing)}" if missing else ""
    source, n = one.source + unknown, len(one.errors_mm)
    return _judgement(tolerances, one.characteristic, one.where, value, expanded, source, n)


def _judgement(
    tolerances: Tolerances,
    characteristic: Characteristic,
    where: str,
    value: float | None,
    expanded: float | None,
    source: str,
    n: int,
    *,
    enough: bool = True,
) -> Judgement | None:
    """Judge one error [mm], of an orientation [mrad], if it was measured often ``enough``; None without a tolerance."""
    limit: float | None = getattr(tolerances, characteristic)
    if limit is None:
        return None
    tolerance, unit = limit * 1e3, "mrad" if characteristic in _ROTATIONS else "mm"
    figures: dict[str, Any] = dict.fromkeys(("value_mm", "expanded_mm", "tolerance_mm"))
    figures |= {f"value_{unit}": value, f"expanded_{unit}": expanded, f"tolerance_{unit}": tolerance}
    return Judgement(
        characteristic=characteristic,
        where=where,
        rule=tolerances.decision,
        conformity=conformity(value, expanded, tolerance, tolerances.decision) if enough else "not decided",
        source=source,
        n=n,
        **figures,
    )


def _undecided(one: Judgement, why: str) -> Judgement:
    """Return the judgement without a decision because of ``why``; unchanged if that is empty or nothing measured."""
    if not why or one.value is None:
        return one
    return one.model_copy(update={"conformity": "not decided", "source": f"{one.source}; {why}"})


def _held_iso(tolerances: Tolerances, results: RunResults) -> tuple[Judgement, ...]:
    """Return the results of the test by ISO 9283 judged by these tolerances; empty if it no longer holds."""
    stored = results.held.iso9283
    if stored is None:
        return ()
    cycles = NORM_CYCLES["pose"] if stored.conditions is None else stored.conditions.cycles
    return judge_characteristics(tolerances, stored.arms, stored.pairs, cycles)


def other_arms_found(results: RunResults) -> str:
    """State the change of arms that the last check found, if it still holds; empty if none."""
    checked = results.held.check
    return f"a later check found: {checked.verdict}" if checked is not None and checked.found_other_arms else ""


def _outdated(results: RunResults, name: StageName, what: str) -> str:
    reason = results.out_of_date.get(name)
    return f"{what} is out of date ({reason})" if reason else ""


def _verified(verify: VerifyResult, measured: int, asked: int, what: str) -> str:
    count = f"{measured} {what}" if measured == asked else f"{measured} of {asked} {what}"
    return f"verification, {count}" + (f" ({verify.stopped})" if verify.stopped else "")


def _unverified(
    results: RunResults, characteristic: Characteristic, held_out: ErrorSummary | None, unit: str = "mm"
) -> str:
    """Say why nothing is verified, and the calibration's error at held-out stops."""
    verify = results.verify
    if (reason := _outdated(results, VERIFY, "the verification")) == "":
        reason = (
            "not verified"
            if verify is None
            else f"the verification measured no {characteristic.replace('_', ' ')} error"
        )
    if held_out is None:
        return _outdated(results, CALIBRATE, f"{reason}; the calibration") or f"{reason}; no held-out figure"
    p95 = "" if held_out.p95 is None else f"95 % within {held_out.p95:.3f} {unit}, "
    return f"{reason}; predicted at {held_out.n} held-out values: {p95}largest {held_out.max:.3f} {unit}"


def _held_out(
    results: RunResults, arm: str, error: Literal["position_mm", "orientation_mrad", "distance_mm"]
) -> ErrorSummary | None:
    calibrate = results.held.calibrate
    found = None if calibrate is None else calibrate.arms.get(arm)
    if found is None:
        return None
    stage = found.validate_[found.best_stage]
    summary: ErrorSummary | None = getattr(stage, error)
    return summary


def _held_out_rotations(results: RunResults, arms: Sequence[str]) -> ErrorSummary | None:
    """Return the held-out errors of orientation [mrad] of an arm, or of one flange in the other's frame."""
    if len(arms) == 1:
        return _held_out(results, arms[0], "orientation_mrad")
    best = best_method(results.pair)
    return None if best is None else results.pair[best].cooperative_mrad


def _distance_errors_mm(targets: Sequence[MeasuredTarget]) -> list[float]:
    """Return the errors [mm] of the distances between measured positions, for all pairs of targets."""

    points = [(one.measured_M, one.wanted_M) for one in targets if one.measured_M and one.wanted_M]
    if len(points) < 2:
        return []
    measured, wanted = np.array(points).transpose(1, 0, 2)
    errors: list[float] = (
        np.abs(scipy.spatial.distance.pdist(measured) - scipy.spatial.distance.pdist(wanted)) * 1e3
    ).tolist()
    return errors


def _both(arms: Sequence[str]) -> str:
    return " and ".join(arms)


TEST_OF: Mapping[Characteristic, IsoTest] = {
    "pose_accuracy": "pose",
    "pose_repeatability": "pose",
    "multidirectional": "multidirectional",
    "distance_accuracy": "distance",
    "distance_repeatability": "distance",
    "drift": "drift",
    "path_accuracy": "path",
    "path_repeatability": "path",
}
"""Characteristic of one arm -> the test that measures it."""


@dataclass(frozen=True)
class FoundValue:
    """A characteristic at one place, for example a pose."""

    characteristic: Characteristic
    at: str
    value: IsoValue


def judge_characteristics(
    tolerances: Tolerances, arms: Mapping[str, ArmIso9283], pairs: tuple[PairIso9283, ...], cycles: int
) -> tuple[Judgement, ...]:
    """Judge each characteristic that has a tolerance, at the place with its largest value.

    Calibrated commands are judged if they were measured, else nominal ones. A characteristic from fewer cycles than the
    norm's is not judged, unless fewer were requested (``cycles``).
    """
    found: list[Judgement] = []
    for name, arm in arms.items():
        kind = _last(arm.tests)
        if kind is not None:
            found += _judged_characteristic(tolerances, name, kind, list(found_in(arm.tests[kind])), cycles)
    for pair in pairs:
        kind = _last(pair.distance)
        if kind is not None:
            each = [FoundValue("cooperative", " and ".join(one.between), one.accuracy) for one in pair.distance[kind]]
            found += _judged_characteristic(tolerances, " and ".join(pair.arms), kind, each, cycles)
    return tuple(found)


def unmeasured_tests(
    tolerances: Tolerances, names: Collection[str], arms: Mapping[str, ArmIso9283]
) -> tuple[IsoTest, ...]:
    """Return the tests of characteristics with a tolerance that are missing for any of the arms ``names``."""
    measured = {
        name: {one.characteristic for tests in arms[name].tests.values() for one in found_in(tests)} for name in arms
    }
    given = [characteristic for characteristic in TEST_OF if getattr(tolerances, characteristic) is not None]
    missing = (one for one in given if any(one not in measured.get(name, ()) for name in names))
    return tuple(dict.fromkeys(TEST_OF[one] for one in missing))


def _judged_characteristic(
    tolerances: Tolerances, where: str, kind: IsoCommands, found: list[FoundValue], cycles: int
) -> Iterator[Judgement]:
    for characteristic in dict.fromkeys(one.characteristic for one in found):
        own = [one for one in found if one.characteristic == characteristic]
        worst = max(own, key=lambda one: abs(one.value.value_mm))
        test = TEST_OF.get(characteristic, "cooperative")
        asked, n = wanted_cycles(test, cycles), min(one.value.n for one in own)
        norm = NORM_CYCLES[test]
        enough = n >= min(asked, norm)
        figures = abs(worst.value.value_mm), worst.value.expanded_mm, _source(worst, kind, n, norm, enough=enough), n
        judged = _judgement(tolerances, characteristic, where, *figures, enough=enough)
        yield from () if judged is None else (judged,)


def _source(worst: FoundValue, kind: IsoCommands, n: int, norm: int, *, enough: bool) -> str:
    cycles = counted(n, "cycle") if n >= norm else f"{n} of {counted(norm, 'cycle')}"
    short = "" if enough else ", too few to judge"
    return f"ISO 9283, {worst.at}, {kind} commands, {cycles}{short}"


def _last(measured: Mapping[IsoCommands, object]) -> IsoCommands | None:
    return next((kind for kind in reversed(ISO_COMMANDS) if measured.get(kind)), None)


def found_in(tests: CommandedTests) -> Iterator[FoundValue]:
    """Yield every characteristic that the tests of an arm measured, at each of its places."""
    for pose in tests.pose:
        yield FoundValue("pose_accuracy", pose.pose, pose.accuracy)
        yield FoundValue("pose_repeatability", pose.pose, pose.repeatability)
    for one in tests.multidirectional:
        yield FoundValue("multidirectional", one.pose, one.variation)
    for pair in tests.distance:
        at = " to ".join(pair.between)
        yield FoundValue("distance_accuracy", at, pair.accuracy)
        yield FoundValue("distance_repeatability", at, pair.repeatability)
    if tests.drift is not None:
        at = f"{tests.drift.pose}, {tests.drift.minutes:.0f} of {NORM_DRIFT_MIN:.0f} min"
        yield FoundValue("drift", at, tests.drift.accuracy)
    for path in tests.path:
        yield FoundValue("path_accuracy", path.path, path.accuracy)
        yield FoundValue("path_repeatability", path.path, path.repeatability)
