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

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
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
from cellapp.ground.results import CALIBRATE, ISO9283, VERIFY, ErrorSummary, Record, StageName, best_method

Budget = Sequence[UncertaintyContribution]
_ROTATIONS: tuple[Characteristic, ...] = ("orientation", "cooperative_orientation")
"""Characteristics in mrad; all others are in mm."""


@dataclass(frozen=True)
class _Measured:
    """The largest error of one characteristic [mm], of an orientation [mrad]: where, from which source, of how many.

    ``value`` is None where nothing was measured, ``expanded`` where its uncertainty is not known. It is not judged
    unless it was measured often ``enough``.
    """

    characteristic: Characteristic
    where: str
    source: str
    value: float | None = None
    expanded: float | None = None
    n: int = 0
    enough: bool = True


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
    tested = list(_held_iso(results))
    found = [
        *(_position(results, arm, budget) for arm, budget in budgets.items()),
        *(_distance(results, arm, budget) for arm, budget in budgets.items()),
        *_cooperative(results, budgets, tested),
        *_orientations(profile, results),
        *tested,
        *_untested(profile, results, tested),
    ]
    return _judged(profile.tolerances, found, other_arms_found(results))


# -- what was measured ------------------------------------------------------------------------------------------------


def _position(results: RunResults, arm: str, budget: Budget) -> _Measured:
    targets = results.verified.of_arm(arm)
    errors = [one.final_mm for one in targets if one.final_mm is not None]
    if not errors:
        return _unverified(results, "position", (arm,), "position_mm")
    source = _verified(results.verified, len(errors), len(targets), "targets")
    return _largest("position", arm, source, errors, budget)


def _distance(results: RunResults, arm: str, budget: Budget) -> _Measured:
    """Collect all pairs of verified targets with compensated commands; a corrected target has no measured position."""
    targets = results.verified.of_arm(arm)
    errors = _distance_errors_mm(targets)
    if not errors:
        return _unverified(results, "distance", (arm,), "distance_mm")
    points = sum(one.measured_M is not None for one in targets)
    verified = _verified(results.verified, points, len(targets), "targets")
    source = f"{verified}, {counted(len(errors), 'distance')} between them"
    return _largest("distance", arm, source, errors, distance_budget(budget))


def _cooperative(
    results: RunResults, budgets: Mapping[str, Budget], tested: Sequence[_Measured]
) -> Iterator[_Measured]:
    """Yield each pair of arms with verified cooperative targets; also the only pair of a cell without any."""
    verify = results.verified
    found = grouped((pair.arms, pair.final_mm) for pair in verify.pairs if pair.final_mm is not None)
    for arms, errors in found.items():
        asked = sum(one.arms == arms for one in verify.pairs)
        source = _verified(verify, len(errors), asked, "pairs of targets")
        yield _largest("cooperative", _both(arms), source, errors, [one for arm in arms for one in budgets[arm]])
    if not found and len(budgets) == 2 and not any(one.characteristic == "cooperative" for one in tested):
        yield _unverified(results, "cooperative", tuple(budgets), "cooperative_mm")


def _orientations(profile: Profile, results: RunResults) -> Iterator[_Measured]:
    """Yield each probe arm's largest error of orientation at verified targets; of every arm if none has a probe.

    Then that of one flange in the other's frame.
    """
    verify = results.verified
    probed = [name for name, arm in profile.arms.items() if arm.smr.probe is not None]
    for arm in probed or profile.arms:
        yield _rotated(profile, results, "orientation", (arm,), verify.of_arm(arm), arm in probed)
    if len(profile.arms) == 2:
        names = tuple(profile.arms)
        yield _rotated(profile, results, "cooperative_orientation", names, verify.pairs, len(probed) == 2)


def _rotated(
    profile: Profile,
    results: RunResults,
    characteristic: Literal["orientation", "cooperative_orientation"],
    arms: tuple[str, ...],
    measured: Sequence[MeasuredTarget | MeasuredPair],
    probed: bool,
) -> _Measured:
    """Return an arm's largest error of orientation, or that of one flange in the other's frame."""
    angles = [its.final_mrad for one in measured if (its := one.orientation) and its.final_mrad is not None]
    if not probed and not angles:
        why = f"not measured: {'the' if len(arms) == 1 else 'a'} flange has no 6-D probe (smr.probe)"
        return _Measured(characteristic, _both(arms), why)
    if not angles:
        return _unverified(results, characteristic, arms, "orientation_mrad" if len(arms) == 1 else "cooperative_mrad")
    what = "targets" if len(arms) == 1 else "pairs of targets"
    source = _verified(results.verified, len(angles), len(measured), what)
    budgets = [orientation_budget(profile, results, arm) for arm in arms]
    expanded = expanded_mrad([one for own in budgets for one in own]) if all(budgets) else None
    return _Measured(characteristic, _both(arms), source, max(angles), expanded, len(angles))


def orientation_budget(profile: Profile, results: RunResults, arm: str) -> tuple[AngleContribution, ...]:
    """Return the contributions to an arm's uncertainty of orientation, at the command with the model's largest one;
    empty if no orientation was predicted."""
    rotations = [one.orientation for one in results.commands if one.arm == arm and one.orientation is not None]
    if not rotations:
        return ()
    worst = max(rotations, key=lambda one: one.model_mrad)
    basis = f"largest of {counted(len(rotations), 'command')}"
    return angle_budget(profile, arm, worst.model_mrad, worst.noise_mrad, basis)


def _held_iso(results: RunResults) -> Iterator[_Measured]:
    """Yield what the test by ISO 9283 measured; nothing if it no longer holds."""
    if (stored := results.held.iso9283) is not None:
        cycles = NORM_CYCLES["pose"] if stored.conditions is None else stored.conditions.cycles
        yield from _tested(stored.arms, stored.pairs, cycles)


def _untested(profile: Profile, results: RunResults, tested: Sequence[_Measured]) -> Iterator[_Measured]:
    """Yield the characteristics of ISO 9283 that were not measured."""
    why = _outdated(results, ISO9283, "the test by ISO 9283") or "not measured"
    known = {(one.characteristic, one.where) for one in tested}
    for name in TEST_OF:
        yield from (_Measured(name, arm, why) for arm in profile.arms if (name, arm) not in known)


# -- inside -----------------------------------------------------------------------------------------------------------


def _judged(tolerances: Tolerances, found: Iterable[_Measured], changed: str = "") -> tuple[Judgement, ...]:
    """Judge what has a tolerance; ``changed`` says why no measurement decides anything, if so."""
    judgements = []
    for one in found:
        limit: float | None = getattr(tolerances, one.characteristic)
        if limit is None:
            continue
        why = changed if one.value is not None else ""
        tolerance, unit = limit * 1e3, "mrad" if one.characteristic in _ROTATIONS else "mm"
        figures: dict[str, Any] = dict.fromkeys(("value_mm", "expanded_mm", "tolerance_mm"))
        figures |= {f"value_{unit}": one.value, f"expanded_{unit}": one.expanded, f"tolerance_{unit}": tolerance}
        decided = one.enough and not why
        judgements.append(
            Judgement(
                characteristic=one.characteristic,
                where=one.where,
                rule=tolerances.decision,
                conformity=conformity(one.value, one.expanded, tolerance, tolerances.decision)
                if decided
                else "not decided",
                source=f"{one.source}; {why}" if why else one.source,
                n=one.n,
                **figures,
            )
        )
    return tuple(judgements)


def _largest(
    characteristic: Characteristic, where: str, source: str, errors_mm: Sequence[float], budget: Budget
) -> _Measured:
    """Return the largest error with its expanded uncertainty, or what is missing for that."""
    missing = not_given(budget)
    unknown = f"; uncertainty not known, as not given: {', '.join(missing)}" if missing else ""
    return _Measured(characteristic, where, source + unknown, max(errors_mm), expanded_mm(budget), len(errors_mm))


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


def _unverified(results: RunResults, characteristic: Characteristic, arms: tuple[str, ...], error: str) -> _Measured:
    """Say why nothing is verified, and the calibration's ``error`` at held-out stops, as its field is called."""
    why = f"the verification measured no {characteristic.replace('_', ' ')} error"
    why = _outdated(results, VERIFY, "the verification") or ("not verified" if results.verify is None else why)
    held_out = _held_out(results, arms, error)
    if held_out is None:
        source = _outdated(results, CALIBRATE, f"{why}; the calibration") or f"{why}; no held-out figure"
        return _Measured(characteristic, _both(arms), source)
    unit = error.rpartition("_")[2]
    p95 = "" if held_out.p95 is None else f"95 % within {held_out.p95:.3f} {unit}, "
    source = f"{why}; predicted at {held_out.n} held-out values: {p95}largest {held_out.max:.3f} {unit}"
    return _Measured(characteristic, _both(arms), source)


def _held_out(results: RunResults, arms: tuple[str, ...], error: str) -> ErrorSummary | None:
    """Return the held-out errors of an arm by the best stage, or of a pair by the best method."""
    best: Record | None = None
    if len(arms) > 1 and (method := best_method(results.pair)) is not None:
        best = results.pair[method]
    elif len(arms) == 1 and (calibrate := results.held.calibrate) is not None and arms[0] in calibrate.arms:
        arm = calibrate.arms[arms[0]]
        best = arm.validate_[arm.best_stage]
    found: ErrorSummary | None = getattr(best, error, None)
    return found


def _distance_errors_mm(targets: Sequence[MeasuredTarget]) -> list[float]:
    """Return the errors [mm] of the distances between measured positions, for all pairs of targets."""
    points = [(one.measured_M, one.wanted_M) for one in targets if one.measured_M and one.wanted_M]
    if len(points) < 2:
        return []
    measured, wanted = (scipy.spatial.distance.pdist(its) for its in np.array(points).transpose(1, 0, 2))
    errors: list[float] = (np.abs(measured - wanted) * 1e3).tolist()
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
    return _judged(tolerances, _tested(arms, pairs, cycles))


def _tested(arms: Mapping[str, ArmIso9283], pairs: tuple[PairIso9283, ...], cycles: int) -> Iterator[_Measured]:
    """Yield the largest value of each characteristic of arms and of pairs."""
    for name, arm in arms.items():
        kind = _last(arm.tests)
        if kind is not None:
            yield from _worst(name, kind, list(found_in(arm.tests[kind])), cycles)
    for pair in pairs:
        kind = _last(pair.distance)
        if kind is not None:
            each = [FoundValue("cooperative", _both(one.between), one.accuracy) for one in pair.distance[kind]]
            yield from _worst(_both(pair.arms), kind, each, cycles)


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


def _worst(where: str, kind: IsoCommands, found: list[FoundValue], cycles: int) -> Iterator[_Measured]:
    for characteristic, own in grouped((one.characteristic, one) for one in found).items():
        worst = max(own, key=lambda one: abs(one.value.value_mm))
        test = TEST_OF.get(characteristic, "cooperative")
        n, norm = min(one.value.n for one in own), NORM_CYCLES[test]
        enough = n >= min(wanted_cycles(test, cycles), norm)
        made = counted(n, "cycle") if n >= norm else f"{n} of {counted(norm, 'cycle')}"
        source = f"ISO 9283, {worst.at}, {kind} commands, {made}{'' if enough else ', too few to judge'}"
        value = abs(worst.value.value_mm)
        yield _Measured(characteristic, where, source, value, worst.value.expanded_mm, n, enough)


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
