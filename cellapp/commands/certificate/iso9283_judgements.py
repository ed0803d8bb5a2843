"""Characteristics of ISO 9283 against the tolerances of a profile: each arm's worst pose decides."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from cellapp.estimation.iso9283.norm import (
    ISO_COMMANDS,
    NORM_CYCLES,
    NORM_DRIFT_MIN,
    IsoCommands,
    IsoTest,
    wanted_cycles,
)
from cellapp.estimation.iso9283.records import ArmIso9283, CommandedTests, IsoValue, PairIso9283
from cellapp.estimation.uncertainty.budget import conformity
from cellapp.estimation.uncertainty.records import Characteristic, Judgement
from cellapp.ground.counting import counted
from cellapp.ground.profile.sections import Tolerances

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
            found += _judged(tolerances, name, kind, list(found_in(arm.tests[kind])), cycles)
    for pair in pairs:
        kind = _last(pair.distance)
        if kind is not None:
            each = [FoundValue("cooperative", " and ".join(one.between), one.accuracy) for one in pair.distance[kind]]
            found += _judged(tolerances, " and ".join(pair.arms), kind, each, cycles)
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


def _judged(
    tolerances: Tolerances, where: str, kind: IsoCommands, found: list[FoundValue], cycles: int
) -> Iterator[Judgement]:
    for characteristic in dict.fromkeys(one.characteristic for one in found):
        tolerance_m = getattr(tolerances, characteristic)
        if tolerance_m is None:
            continue
        own = [one for one in found if one.characteristic == characteristic]
        worst = max(own, key=lambda one: abs(one.value.value_mm))
        test = TEST_OF.get(characteristic, "cooperative")
        asked, n = wanted_cycles(test, cycles), min(one.value.n for one in own)
        norm = NORM_CYCLES[test]
        value = abs(worst.value.value_mm)
        enough = n >= min(asked, norm)
        expanded = worst.value.expanded_mm
        yield Judgement(
            characteristic=characteristic,
            where=where,
            value_mm=value,
            expanded_mm=expanded,
            tolerance_mm=tolerance_m * 1e3,
            rule=tolerances.decision,
            conformity=conformity(value, expanded, tolerance_m * 1e3, tolerances.decision) if enough else "cannot say",
            source=_source(worst, kind, n, norm, enough=enough),
            n=n,
        )


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
