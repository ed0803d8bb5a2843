"""Differences of two runs: profile, and of each arm and of the pair every value with what it differs by."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import zip_longest

from cellapp.cell.profile.loader import leaves
from cellapp.cell.profile.messages import dotted
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.run_arms import arm_identities
from cellapp.commands.run_results import RunResults
from cellapp.commands.run_state import RunState
from cellapp.commands.stored_model import comparable_arms
from cellapp.commands.view.table import Table, table_of, with_rows
from cellapp.commands.view.words import display_unit, geometry_unit, place_words
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import AcceptedEffect
from cellapp.estimation.monitoring.parameter_changes import Difference, differences
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.results import BEST_METHODS, Estimate, Record, Result


class ProfileDifference(Record):
    """A key of the profile, as ``arms.left.base.position[0]``, with its values as JSON; None where it is missing."""

    key: str
    a: str | None
    b: str | None


class ValueComparison(Record):
    """A parameter of two runs, all in ``unit``; None where a run does not have it.

    ``difference`` is b less a, ``standard_uncertainty`` that of the difference, ``z`` one over the other; both None
    where the value has no standard error. ``of`` says what the value belongs to: "geometry" or an effect
    with its place.
    """

    of: str
    name: str
    unit: str
    a: float | None
    b: float | None
    difference: float | None
    standard_uncertainty: float | None
    z: float | None

    @property
    def differs(self) -> bool:
        """Whether the two values differ by more than three standard uncertainties."""
        return self.z is not None and abs(self.z) > MOST_Z


MOST_Z = 3.0
"""Difference in standard uncertainties from which it counts: 0.3 % of normal differences are larger."""
GEOMETRY, TRANSFORM = "geometry", "inter-base transform"


class RunComparison(Result, schema="cellapp-comparison", version=2):
    """``show --against``: where two runs differ; ``notes`` say what cannot be compared, and what is out of date."""

    a: str
    b: str
    profile: tuple[ProfileDifference, ...]
    arms: Mapping[str, tuple[ValueComparison, ...]]
    pair: tuple[ValueComparison, ...]
    notes: tuple[str, ...]


_NOT_STORED: Mapping[str, str] = {"calibrate": "is not calibrated", "discover": "was not searched for missing effects"}


def compare_runs(a: RunFile, b: RunFile) -> RunComparison:
    """Compare two runs; notes name what only one of them has and what cannot be compared.

    Raises
    ------
    InputError
        If both are the same run, or stored data of one are damaged.
    """
    if a.folder.resolve() == b.folder.resolve():
        raise InputError(f"show: --against: {a.folder} and {b.folder} are the same run; give two different runs")
    states = RunState(a), RunState(b)
    first, second = (one.results for one in states)
    models = [comparable_arms(one.run, one.stages) for one in states]
    common = [name for name in a.profile.arms if name in b.profile.arms]
    others = dict(_other_ones(a, b, common))
    arms = {}
    for name in common:
        same = name not in others and all(name in model for model in models)
        moved = differences(models[0][name], models[1][name]) if same else []
        found = [None if run.discover is None else run.discover.arms.get(name) for run in (first, second)]
        effects = _effects(*(() if arm is None else arm.accepted for arm in found))
        arms[name] = (*map(_moved, moved), *effects)
    return RunComparison(
        a=str(a.folder),
        b=str(b.folder),
        profile=tuple(_profile_differences(a.profile, b.profile)),
        arms=arms,
        pair=tuple(_of_pair(first.calibrate, second.calibrate)),
        notes=(*_other_arms(a, b), *others.values(), *_missing(first), *_missing(second)),
    )


# -- what cannot be compared ------------------------------------------------------------------------------------------


def _other_arms(a: RunFile, b: RunFile) -> Iterator[str]:
    for run, other in ((a, b), (b, a)):
        for name in run.profile.arms:
            if name not in other.profile.arms:
                names = ", ".join(other.profile.arms)
                yield f"arm '{name}' is in {run.folder} only; the arms of {other.folder} are {names}"


def _other_ones(a: RunFile, b: RunFile, common: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield arms with one name but different types or serial numbers, each with a note."""
    first, second = arm_identities(a), arm_identities(b)
    for name in common:
        what, values = "is of type", [run.profile.arms[name].type.model for run in (a, b)]
        if values[0] == values[1]:
            if not first[name].is_other_than(second[name]):
                continue
            what, values = "has the serial number", [str(one[name].serial) for one in (first, second)]
        yield (
            name,
            f"arm '{name}' {what} {values[0]} in {a.folder} and {values[1]} in {b.folder}; parameters of different arms"
            " are not compared",
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
    first, second = leaves(a), leaves(b)
    for key in dict.fromkeys([*first, *second]):
        if first.get(key) != second.get(key):
            yield ProfileDifference(key=dotted(key), a=first.get(key), b=second.get(key))


# -- values -----------------------------------------------------------------------------------------------------------


def _compared(
    of: str, name: str, unit: str, a: float | None, b: float | None, change: float | None, u: float | None = None
) -> ValueComparison:
    z = change / u if change is not None and u else None
    return ValueComparison(of=of, name=name, unit=unit, a=a, b=b, difference=change, standard_uncertainty=u, z=z)


def _moved(one: Difference) -> ValueComparison:
    values = one.first.value, one.later.value
    return _compared(GEOMETRY, one.name, one.unit, *values, one.difference, one.standard_uncertainty)


def _of_pair(a: CalibrateResult | None, b: CalibrateResult | None) -> Iterator[ValueComparison]:
    """Yield the inter-base transforms by the best method that both runs have."""
    first, second = ({} if run is None else run.pair for run in (a, b))
    method = next((method for method in BEST_METHODS if method in first and method in second), None)
    if method is not None:
        yield from _values(TRANSFORM, first[method].identified, second[method].identified)


def _effects(a: Sequence[AcceptedEffect], b: Sequence[AcceptedEffect]) -> Iterator[ValueComparison]:
    """Pair the effects of two runs by name, and effects of the same name by place, then by order."""
    for slug in dict.fromkeys(effect.effect for effect in (*a, *b)):
        first, second = ([effect for effect in own if effect.effect == slug] for own in (a, b))
        pairs = [(one, other) for one in first for other in second if one.where == other.where]
        paired = [id(effect) for pair in pairs for effect in pair]
        unpaired = ([effect for effect in own if id(effect) not in paired] for own in (first, second))
        for one, other in (*pairs, *zip_longest(*unpaired)):
            known = [effect for effect in (one, other) if effect is not None]
            places = " / ".join(dict.fromkeys(place_words(effect.where) for effect in known))
            sizes = ({} if effect is None else effect.parameters for effect in (one, other))
            yield from _values(f"{known[0].title} ({places})", *sizes)


def _values(of: str, a: Mapping[str, Estimate], b: Mapping[str, Estimate]) -> Iterator[ValueComparison]:
    for name in dict.fromkeys([*a, *b]):
        one, other = a.get(name), b.get(name)
        difference = combined = None
        if one is not None and other is not None and one.unit == other.unit:
            difference = other.value - one.value
            if one.unit == "rad":
                difference = math.remainder(difference, math.tau)  # angles near half a turn may differ in sign
            if one.standard_error is not None and other.standard_error is not None:
                combined = math.hypot(one.standard_error, other.standard_error)
        unit = " or ".join(dict.fromkeys(estimate.unit for estimate in (one, other) if estimate is not None))
        before, after = (None if estimate is None else estimate.value for estimate in (one, other))
        yield _compared(of, name, unit, before, after, difference, combined)


def comparison_tables(result: RunComparison) -> list[Table]:
    """Show differences of the profile, then the values of each arm and of the pair."""
    profile = table_of("Profile: what differs", result.profile, ("key", "key"), ("a", "a"), ("b", "b"))
    arms = [_value_table(f"Arm {name}", values) for name, values in result.arms.items()]
    return with_rows(profile, *arms, _value_table("Pair", result.pair))


def comparison_sentences(result: RunComparison) -> list[str]:
    """Name folders a and b, state which values differ, and what cannot be compared."""
    sentences = [f"a: {result.a}", f"b: {result.b}", *([] if result.profile else ["the profiles are the same"])]
    subjects = {**{f"arm {name}": values for name, values in result.arms.items()}, "pair": result.pair}
    for subject, values in subjects.items():
        judged = [value for value in values if value.z is not None]
        differing = [f"{value.of}: {value.name}" for value in judged if value.differs]
        if judged:
            words = f"{len(differing)} of {counted(len(judged), 'value differs', 'values differ')} by more than"
            names = f": {', '.join(differing)}" if differing else ""
            sentences.append(f"{subject}: {words} {MOST_Z:g} standard uncertainties{names}")
        for run in "ab":
            own = dict.fromkeys(value.of for value in values if getattr(value, run) is not None)
            both = {value.of for value in values if getattr(value, "ba"["ab".index(run)]) is not None}
            sentences += [f"{subject}: {of} is in {run} only" for of in own if of not in both]
    return [*sentences, *result.notes]


def _value_table(title: str, values: Sequence[ValueComparison]) -> Table:
    shown = [
        (value, *(geometry_unit if value.of in (GEOMETRY, TRANSFORM) else display_unit)(value.unit)) for value in values
    ]

    def scaled(name: str) -> Callable[[tuple[ValueComparison, float, str]], float | None]:
        return lambda row: None if (number := getattr(row[0], name)) is None else row[1] * number

    return table_of(
        title,
        shown,
        ("of", lambda row: row[0].of),
        ("value", lambda row: row[0].name),
        ("b - a", scaled("difference"), "+.4f"),
        ("u(b - a)", scaled("standard_uncertainty"), ".4f"),
        ("z", lambda row: row[0].z, "+.1f"),
        ("differs", lambda row: "yes" if row[0].differs else ""),
        ("unit", lambda row: row[2]),
        ("a", scaled("a"), ".4f"),
        ("b", scaled("b"), ".4f"),
    )
