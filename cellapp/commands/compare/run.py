"""Differences of two runs: profile, parameters, held-out errors, effects, inter-base transform, verification."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import Literal

from cellapp.cell.profile import profile_to_json
from cellapp.cell.profile.messages import KeyPath, dotted
from cellapp.cell.run.arm_identity import arm_identities
from cellapp.cell.run.file import RunFile
from cellapp.cell.targets.records import ArmVerification
from cellapp.commands.compare.request import CompareRequest
from cellapp.commands.record import Request, View, Work
from cellapp.commands.report.result import RunResults, read_results
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import comparable_arms
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.commands.view.words import METHOD_WORDS, display_unit, geometry_unit, place_words
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import AcceptedEffect, Place
from cellapp.estimation.monitoring.moved import CalibratedArm, Difference, differences
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.results import BEST_METHODS, METHODS, STAGES, ErrorSummary, Estimate, Method, Record, Result, Stage


class ProfileDifference(Record):
    """A key of the profile, as ``arms.left.base.position[0]``, with its values as JSON; None where it is missing."""

    key: str
    a: str | None
    b: str | None


class ValueComparison(Record):
    """A parameter of two runs with standard errors, all in ``unit``; None where a run does not have it.

    ``difference`` is b less a, ``standard_uncertainty`` that of the difference, ``z`` one over the other.
    """

    name: str
    unit: str
    a: float | None
    b: float | None
    a_standard_error: float | None
    b_standard_error: float | None
    difference: float | None
    standard_uncertainty: float | None
    z: float | None

    @property
    def differs(self) -> bool:
        """Whether the two values differ by more than three standard uncertainties."""
        return self.z is not None and abs(self.z) > MOST_Z


MOST_Z = 3.0
"""Difference in standard uncertainties from which it counts: 0.3 % of normal differences are larger."""


class ErrorComparison(Record):
    """Mean and rms error of two runs [mm]; None where a run does not have it."""

    a_mean_mm: float | None
    b_mean_mm: float | None
    a_rms_mm: float | None
    b_rms_mm: float | None


class EffectComparison(Record):
    """An effect in one run or in both: where it acts, None in a run without it, and its sizes."""

    effect: str
    title: str
    a_where: Place | None
    b_where: Place | None
    parameters: tuple[ValueComparison, ...]

    @property
    def found_in(self) -> Literal["a", "b", "both"]:
        """Which of the runs has the effect."""
        if self.a_where is not None and self.b_where is not None:
            return "both"
        return "b" if self.a_where is None else "a"


class ArmComparison(Record):
    """One arm of two runs: parameters of the geometry, held-out errors by stage, effects, verification.

    ``verified_mm`` has the distances from the targets with nominal and with compensated commands.
    """

    parameters: tuple[ValueComparison, ...] = ()
    heldout_mm: Mapping[Stage, ErrorComparison] = {}
    effects: tuple[EffectComparison, ...] = ()
    verified_mm: Mapping[Literal["nominal", "compensated"], ErrorComparison] = {}


class PairComparison(Record):
    """The inter-base transform of ``method`` in two runs, and the pair's held-out cooperative errors by method.

    ``distance_mm`` is the distance between the two origins of the second base in the frame of the first.
    """

    method: Method | None
    parameters: tuple[ValueComparison, ...] = ()
    distance_mm: float | None = None
    cooperative_mm: Mapping[Method, ErrorComparison] = {}


class RunComparison(Result, schema="cellapp-comparison"):
    """``compare``: where two runs differ; ``notes`` say what cannot be compared, and what is out of date."""

    a: str
    b: str
    profile: tuple[ProfileDifference, ...]
    arms: Mapping[str, ArmComparison]
    pair: PairComparison | None
    notes: tuple[str, ...]


_NOT_STORED: Mapping[str, str] = {
    "calibrate": "is not calibrated",
    "discover": "was not searched for missing effects",
    "verify": "was not verified at targets",
}


def run(request: CompareRequest, work: Work) -> RunComparison:
    """Compare the two runs."""
    with RunFile.open(request.first) as a, RunFile.open(request.second) as b:
        return compare_runs(a, b)


def compare_runs(a: RunFile, b: RunFile) -> RunComparison:
    """Compare two runs; notes name what only one of them has and what cannot be compared.

    Raises
    ------
    InputError
        If both are the same run, or stored data of one are damaged.
    """
    if a.folder.resolve() == b.folder.resolve():
        raise InputError(f"compare: {a.folder} and {b.folder} are the same run; give two different runs")
    stages = read_stages(a), read_stages(b)
    first, second = read_results(a, stages[0]), read_results(b, stages[1])
    models = comparable_arms(a, stages[0]), comparable_arms(b, stages[1])
    common = [name for name in a.profile.arms if name in b.profile.arms]
    others = dict(_other_serials(a, b, common))
    notes = [*_other_arms(a, b), *_other_types(a, b, common), *others.values(), *_missing(first), *_missing(second)]
    return RunComparison(
        a=str(a.folder),
        b=str(b.folder),
        profile=tuple(_profile_differences(a.profile, b.profile)),
        arms={
            name: _arm(
                name,
                first,
                second,
                _moved(name, *models) if name not in others and _same_type(a, b, name) else (),
            )
            for name in common
        },
        pair=_pair(first.calibrate, second.calibrate),
        notes=tuple(notes),
    )


# -- what cannot be compared ------------------------------------------------------------------------------------------


def _other_arms(a: RunFile, b: RunFile) -> Iterator[str]:
    for run, other in ((a, b), (b, a)):
        for name in run.profile.arms:
            if name not in other.profile.arms:
                names = ", ".join(other.profile.arms)
                yield f"arm '{name}' is in {run.folder} only; the arms of {other.folder} are {names}"


def _same_type(a: RunFile, b: RunFile, name: str) -> bool:
    return a.profile.arms[name].type.model == b.profile.arms[name].type.model


def _other_types(a: RunFile, b: RunFile, common: Sequence[str]) -> Iterator[str]:
    for name in common:
        if not _same_type(a, b, name):
            types = [run.profile.arms[name].type.model for run in (a, b)]
            yield (
                f"arm '{name}' is of type {types[0]} in {a.folder} and {types[1]} in {b.folder}; parameters of"
                " different arms are not compared"
            )


def _other_serials(a: RunFile, b: RunFile, common: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield arms with one name but different serial numbers, each with a note."""
    first, second = arm_identities(a), arm_identities(b)
    for name in common:
        if first[name].is_other_than(second[name]):
            yield (
                name,
                f"arm '{name}' has the serial number {first[name].serial} in {a.folder} and {second[name].serial} in"
                f" {b.folder}; parameters of different arms are not compared",
            )


def _missing(results: RunResults) -> Iterator[str]:
    """Yield results that a run lacks, and those that no longer hold."""
    for name, words in _NOT_STORED.items():
        if getattr(results, name) is None and name not in results.out_of_date:
            yield f"{results.run} {words}"
    reasons = grouped((reason, stage) for stage, reason in results.out_of_date.items())
    for reason, stages in reasons.items():
        yield f"{results.run}: out of date: {', '.join(stages)} ({reason})"


# -- profile ----------------------------------------------------------------------------------------------------------


def _profile_differences(a: Profile, b: Profile) -> Iterator[ProfileDifference]:
    first, second = _leaves(a), _leaves(b)
    for key in dict.fromkeys([*first, *second]):
        if first.get(key) != second.get(key):
            yield ProfileDifference(key=key, a=first.get(key), b=second.get(key))


def _leaves(profile: Profile) -> dict[str, str]:
    """Return every value of a profile as JSON, by its key, as ``arms.left.base.position[0]``."""
    return {dotted(at): json.dumps(value, ensure_ascii=False) for at, value in _walk((), _content(profile))}


def _content(profile: Profile) -> object:
    content: object = json.loads(profile_to_json(profile))
    return content


def _walk(at: KeyPath, value: object) -> Iterator[tuple[KeyPath, object]]:
    if isinstance(value, dict) and value:
        for key, inside in value.items():
            yield from _walk((*at, str(key)), inside)
    elif isinstance(value, list) and value:
        for index, inside in enumerate(value):
            yield from _walk((*at, index), inside)
    else:
        yield at, value


# -- arms -------------------------------------------------------------------------------------------------------------


def _moved(name: str, a: Mapping[str, CalibratedArm], b: Mapping[str, CalibratedArm]) -> tuple[ValueComparison, ...]:
    """Compare the geometry of one arm, of the models in force; empty if a run has none with a covariance."""
    return tuple(map(_of_difference, differences(a[name], b[name]))) if name in a and name in b else ()


def _of_difference(one: Difference) -> ValueComparison:
    return ValueComparison(
        name=one.name,
        unit=one.unit,
        a=one.first.value,
        b=one.later.value,
        a_standard_error=one.first.standard_error,
        b_standard_error=one.later.standard_error,
        difference=one.difference,
        standard_uncertainty=one.standard_uncertainty,
        z=one.difference / one.standard_uncertainty if one.standard_uncertainty > 0.0 else None,
    )


def _arm(name: str, a: RunResults, b: RunResults, parameters: tuple[ValueComparison, ...]) -> ArmComparison:
    first, second = (None if run.calibrate is None else run.calibrate.arms.get(name) for run in (a, b))
    found = [None if run.discover is None else run.discover.arms.get(name) for run in (a, b)]
    verified = [None if run.verify is None else run.verify.arms.get(name) for run in (a, b)]
    errors = [{} if arm is None else arm.validate_ for arm in (first, second)]
    return ArmComparison(
        parameters=parameters,
        heldout_mm={
            stage: _errors(*(own[stage].position_mm if stage in own else None for own in errors))
            for stage in STAGES
            if any(stage in own for own in errors)
        },
        effects=_effects(*(() if arm is None else arm.accepted for arm in found)),
        verified_mm=_verified(*verified),
    )


def _verified(
    a: ArmVerification | None, b: ArmVerification | None
) -> dict[Literal["nominal", "compensated"], ErrorComparison]:
    if a is None and b is None:
        return {}
    return {
        "nominal": _errors(None if a is None else a.nominal_mm, None if b is None else b.nominal_mm),
        "compensated": _errors(None if a is None else a.compensated_mm, None if b is None else b.compensated_mm),
    }


def _errors(a: ErrorSummary | None, b: ErrorSummary | None) -> ErrorComparison:
    return ErrorComparison(
        a_mean_mm=None if a is None else a.mean,
        b_mean_mm=None if b is None else b.mean,
        a_rms_mm=None if a is None else a.rms,
        b_rms_mm=None if b is None else b.rms,
    )


def _values(a: Mapping[str, Estimate], b: Mapping[str, Estimate]) -> tuple[ValueComparison, ...]:
    return tuple(_value(name, a.get(name), b.get(name)) for name in dict.fromkeys([*a, *b]))


def _value(name: str, a: Estimate | None, b: Estimate | None) -> ValueComparison:
    difference = combined = None
    if a is not None and b is not None and a.unit == b.unit:
        difference = b.value - a.value
        if a.unit == "rad":
            difference = math.remainder(difference, math.tau)  # angles near half a turn may differ in sign
        if a.standard_error is not None and b.standard_error is not None:
            combined = math.hypot(a.standard_error, b.standard_error)
    return ValueComparison(
        name=name,
        unit=" or ".join(dict.fromkeys(estimate.unit for estimate in (a, b) if estimate is not None)),
        a=None if a is None else a.value,
        b=None if b is None else b.value,
        a_standard_error=None if a is None else a.standard_error,
        b_standard_error=None if b is None else b.standard_error,
        difference=difference,
        standard_uncertainty=combined,
        z=difference / combined if difference is not None and combined else None,
    )


# -- effects ----------------------------------------------------------------------------------------------------------


def _effects(a: Sequence[AcceptedEffect], b: Sequence[AcceptedEffect]) -> tuple[EffectComparison, ...]:
    """Pair the effects of two runs by name, and effects of the same name by place, then by order."""
    compared = []
    for slug in dict.fromkeys(effect.effect for effect in (*a, *b)):
        first = [effect for effect in a if effect.effect == slug]
        second = [effect for effect in b if effect.effect == slug]
        for effect in first.copy():
            twin = next((other for other in second if other.where == effect.where), None)
            if twin is not None:
                compared.append(_effect(effect, twin))
                first.remove(effect)
                second.remove(twin)
        compared += [_effect(one, other) for one, other in zip_longest(first, second)]
    return tuple(compared)


def _effect(a: AcceptedEffect | None, b: AcceptedEffect | None) -> EffectComparison:
    known = a or b
    assert known is not None
    return EffectComparison(
        effect=known.effect,
        title=known.title,
        a_where=None if a is None else a.where,
        b_where=None if b is None else b.where,
        parameters=_values(a.parameters if a else {}, b.parameters if b else {}),
    )


# -- pair -------------------------------------------------------------------------------------------------------------


def _pair(a: CalibrateResult | None, b: CalibrateResult | None) -> PairComparison | None:
    """Compare the pair's results; None if neither run has a pair."""
    first, second = ({} if run is None else run.pair for run in (a, b))
    if not first and not second:
        return None
    method = next((method for method in BEST_METHODS if method in first and method in second), None)
    parameters = () if method is None else _values(first[method].identified, second[method].identified)
    return PairComparison(
        method=method,
        parameters=parameters,
        distance_mm=_distance_mm(parameters),
        cooperative_mm={
            method: _errors(*(own[method].cooperative_mm if method in own else None for own in (first, second)))
            for method in METHODS
            if method in first or method in second
        },
    )


def _distance_mm(parameters: Sequence[ValueComparison]) -> float | None:
    """Return the length [mm] of the difference of the transforms' translations x, y, z [m]."""
    differences = {value.name: value.difference for value in parameters}
    lengths = [differences.get(axis) for axis in ("x", "y", "z")]
    known = [length for length in lengths if length is not None]
    return math.hypot(*known) * 1e3 if len(known) == 3 else None


_MM = ".4f"
_MISSING = "-"
ShownIn = Callable[[str], tuple[float, str]]
"""Stored unit -> factor and display unit."""
_ERRORS = (
    *(number_column(f"{run}, {measure}", _MM) for measure in ("mean", "rms") for run in ("a", "b")),
    number_column("change of mean", "+.1%"),
)


def view(result: RunComparison, request: Request | None = None) -> View:
    """Show the differences of two runs."""
    return View((*comparison_tables(result), *comparison_sentences(result)))


def comparison_tables(result: RunComparison) -> list[Table]:
    """Show differences of the profile; each arm's held-out errors, parameters, effects, targets; then the pair."""
    tables = []
    if result.profile:
        rows = tuple((entry.key, entry.a or _MISSING, entry.b or _MISSING) for entry in result.profile)
        tables.append(Table("Profile: what differs", (Column("key"), Column("a"), Column("b")), rows))
    for name, arm in result.arms.items():
        tables += _arm_tables(name, arm)
    if result.pair is not None:
        by_method = [(METHOD_WORDS[key], errors) for key, errors in result.pair.cooperative_mm.items()]
        tables += _error_tables("Pair: held-out cooperative errors [mm]", "method", by_method)
        method = "" if result.pair.method is None else f", {METHOD_WORDS[result.pair.method]}"
        tables += _value_tables(f"Pair: inter-base transform{method}", result.pair.parameters, geometry_unit)
    return tables


def comparison_sentences(result: RunComparison) -> list[str]:
    """Name folders a and b, state the differences in a sentence per subject, and what cannot be compared."""
    sentences = [f"a: {result.a}", f"b: {result.b}"]
    if not result.profile:
        sentences.append("the profiles are the same")
    for name, arm in result.arms.items():
        sentences += _differing(f"arm {name}", arm.parameters)
        sentences += [_found_words(name, effect) for effect in arm.effects]
    if result.pair is not None:
        sentences += _differing("inter-base transform", result.pair.parameters)
        if result.pair.distance_mm is not None:
            sentences.append(
                f"inter-base transform: the origin of the second base differs by {result.pair.distance_mm:.3f} mm"
            )
    if any(value.z is not None for arm in result.arms.values() for value in arm.parameters):
        sentences.append("z: difference in standard uncertainties u; readings of both runs count as independent")
    return [*sentences, *result.notes]


def _arm_tables(name: str, arm: ArmComparison) -> list[Table]:
    tables = [
        *_error_tables(f"Arm {name}: held-out position errors [mm]", "stage", arm.heldout_mm.items()),
        *_value_tables(f"Arm {name}: identified parameters", arm.parameters, geometry_unit),
    ]
    for effect in arm.effects:
        tables += _value_tables(f"Arm {name}: {effect.title}", effect.parameters, display_unit)
    return tables + _error_tables(f"Arm {name}: distances from targets [mm]", "command", arm.verified_mm.items())


def _error_tables(title: str, subject: str, errors: Iterable[tuple[str, ErrorComparison]]) -> list[Table]:
    rows = tuple(
        (name, entry.a_mean_mm, entry.b_mean_mm, entry.a_rms_mm, entry.b_rms_mm, _change(entry))
        for name, entry in errors
    )
    return [Table(title, (Column(subject), *_ERRORS), rows)] if rows else []


def _change(entry: ErrorComparison) -> float | None:
    """Return the relative change of the mean error from a to b; None if it is not known."""
    if entry.a_mean_mm is None or entry.b_mean_mm is None or entry.a_mean_mm == 0.0:
        return None
    return entry.b_mean_mm / entry.a_mean_mm - 1.0


def _value_tables(title: str, values: Sequence[ValueComparison], shown_in: ShownIn) -> list[Table]:
    if not values:
        return []
    columns = (
        Column("parameter"),
        number_column("b - a", "+.4f"),
        number_column("u(b - a)", ".4f"),
        number_column("z", "+.1f"),
        Column("differs"),
        Column("unit"),
        number_column("a", ".4f"),
        number_column("b", ".4f"),
    )
    return [Table(title, columns, tuple(_value_row(value, *shown_in(value.unit)) for value in values))]


def _value_row(value: ValueComparison, factor: float, unit: str) -> tuple[Cell, ...]:
    difference, uncertainty, a, b = (
        None if number is None else number * factor
        for number in (value.difference, value.standard_uncertainty, value.a, value.b)
    )
    return (value.name, difference, uncertainty, value.z, "yes" if value.differs else "", unit, a, b)


def _differing(subject: str, values: Sequence[ValueComparison]) -> Iterator[str]:
    judged = [value for value in values if value.z is not None]
    differing = [value.name for value in judged if value.differs]
    if differing:
        yield (
            f"{subject}: {len(differing)} of {counted(len(judged), 'parameter differs', 'parameters differ')} by"
            f" more than {MOST_Z:g} standard uncertainties: {', '.join(differing)}"
        )
    elif judged:
        yield f"{subject}: no parameter differs by more than {MOST_Z:g} standard uncertainties"


def _found_words(name: str, effect: EffectComparison) -> str:
    where = [place_words(place) for place in (effect.a_where, effect.b_where) if place is not None]
    if effect.found_in != "both":
        return f"arm {name}: {effect.title} ({where[0]}) was found in {effect.found_in} only"
    places = where[0] if where[0] == where[1] else f"{where[0]} in a, {where[1]} in b"
    return f"arm {name}: {effect.title} ({places}) was found in both; {_size_words(effect.parameters)}"


def _size_words(values: Sequence[ValueComparison]) -> str:
    differing = [f"{value.name} (z = {value.z:+.1f})" for value in values if value.differs]
    if differing:
        return f"sizes differ: {', '.join(differing)}"
    return "sizes agree" if any(value.z is not None for value in values) else "sizes cannot be compared"
