"""Tables and sentences of ``compare``: differences of two runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from cellapp.commands.compare.result import (
    MOST_Z,
    ArmComparison,
    EffectComparison,
    ErrorComparison,
    RunComparison,
    ValueComparison,
)
from cellapp.commands.record import Request, View
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.commands.view.words import METHOD_WORDS, display_unit, geometry_unit, place_words
from cellapp.ground.counting import counted

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
