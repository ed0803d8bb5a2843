"""Tables and sentences of ``fleet``, and of ``compare`` with more than two runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from cellapp.commands.fleet.request import FleetRequest
from cellapp.commands.record import Request, View
from cellapp.commands.view.table import (
    MOST_ROWS,
    Cell,
    Column,
    Field,
    Table,
    most_urgent,
    number_column,
    part_table,
    table_of,
    with_rows,
)
from cellapp.commands.view.words import display_unit, place_words
from cellapp.estimation.monitoring.fleet.condition import FIGURE_WORDS, drift_words, leads_away
from cellapp.estimation.monitoring.fleet.records import (
    ArmHistory,
    DatedValue,
    EffectHistory,
    Figure,
    FleetResult,
    PairHistory,
    ParameterHistory,
    Trend,
)
from cellapp.ground.counting import counted
from cellapp.ground.times import day_of

_MM = ".3f"
_FEW_ARMS = 4
"""Most arms that each have their own tables in a terminal: two cells."""
_MOST_PARAMETERS = 12
"""Most parameters in an arm's table, those with the largest differences; the JSON and the page have all."""
_KNOWN_BY = {
    "controller": "serial number of its controller",
    "profile": "serial number in the profile",
    "names": "names of profile and arm, and its type: no serial number is known",
}


def view(result: FleetResult, request: Request | None = None) -> View:
    """Show every arm over its runs; on request, arms beyond tolerance or changed make it fail."""
    asked = request if isinstance(request, FleetRequest) else None
    page = [f"page: {asked.page}"] if asked is not None and asked.page is not None else []
    complaints = result.complaints() if asked is not None and asked.strict else []
    failed = [f"{len(complaints)} of {counted(len(result.arms), 'arm')}: {'; '.join(complaints)}"] if complaints else []
    return View((*fleet_tables(result), *fleet_sentences(result), *page), failed)


def fleet_tables(result: FleetResult) -> list[Table]:
    """Show arms with their condition, runs with their figures, and each arm's changes, effects and trends.

    Of a large fleet, only arms with something to report have their own tables.
    """
    tables = [arms_table(result), runs_table(result)]
    for name, arm in _detailed(result).items():
        tables += arm_tables(name, arm)
    tables += [pair_table(pair) for pair in result.pairs if pair.parameters]
    return [table for table in tables if table.rows]


def fleet_sentences(result: FleetResult) -> list[str]:
    """State each arm's condition with reasons, trends, what cannot be read or compared, and the certainty of all."""
    sentences = [sentence for name, arm in result.arms.items() for sentence in arm_sentences(name, arm)]
    sentences += [pair_sentence(pair) for pair in result.pairs]
    sentences += [run.problem for run in result.runs if run.problem]
    sentences += [f"{run.run}: {note}" for run in result.runs for note in run.notes]
    if left_out := len(result.arms) - len(_detailed(result)):
        sentences.append(
            f"tables of {counted(left_out, 'arm')} without a finding are left out; --page and --json have all"
        )
    if result.comparisons or result.trends_tested:
        sentences.append(certainty_sentence(result))
    return [*sentences, *result.notes]


def _detailed(result: FleetResult) -> Mapping[str, ArmHistory]:
    """Return the arms that get their own tables."""
    if len(result.arms) <= _FEW_ARMS:
        return result.arms
    return {name: arm for name, arm in result.arms.items() if arm.reasons}


def certainty_sentence(result: FleetResult) -> str:
    """State the false alarm rate and what it covers."""
    return (
        f"false alarm: if nothing had changed in the whole fleet, anything would be named with a chance of at most"
        f" {100.0 * result.false_alarm:g} %; {counted(result.comparisons, 'difference')} from the first runs share"
        f" one half, {counted(result.trends_tested, 'trend')} the other"
    )


def arm_sentences(name: str, arm: ArmHistory) -> list[str]:
    """State condition, reasons and trends of one arm."""
    runs = counted(len(arm.runs), "run")
    trends = {drift_words(trend) for trend in arm.trends if leads_away(trend)}
    return [
        f"{name}: {arm.condition} ({runs}; known by the {_KNOWN_BY[arm.known_by]})",
        *(f"{name}: {reason}" for reason in arm.reasons if reason not in trends),
        *(f"{name}: {sentence}" for sentence in trend_sentences(arm)),
        *(f"{name}: {note}" for note in arm.notes),
        *(f"{name}: {effect_words(effect)}" for effect in arm.effects if effect.state == "renamed"),
    ]


def trend_sentences(arm: ArmHistory) -> Iterator[str]:
    """Yield proven trends and when they reach the tolerance; else that none is proven or there are too few values."""
    if not arm.trends:
        yield "too few runs at different times for a trend; it needs four"
        return
    proven = [trend for trend in arm.trends if trend.proven]
    if not proven:
        yield f"no trend is proven in {len(arm.trends)} figures and parameters"
    for trend in proven:
        yield trend_words(trend)


def trend_words(trend: Trend) -> str:
    """State the rate of a trend and, if it leads to the tolerance, when it gets there."""
    subject = f"{drift_words(trend)} (standard error {trend.slope_standard_error:.4f})"
    if trend.crossing is None:
        return subject
    limit = f"{trend.crossing.tolerance_mm:g} mm"
    will = f"have moved the SMR by {limit} since the newest calibration" if trend.figure == "parameter" else ""
    will = will or f"reach {limit}"
    return f"{subject}; at this rate it will {will} in {_months(trend.crossing.months)} (95 %: {_between(trend)})"


def _months(months: float) -> str:
    if months < 2.0:
        return f"{months * 30.4375:.0f} days"
    return f"{months:.0f} months" if months < 24.0 else f"{months / 12.0:.0f} years"


def _between(trend: Trend) -> str:
    assert trend.crossing is not None
    earliest, latest = trend.crossing.earliest, trend.crossing.latest
    if earliest is None:
        return "no limits"
    return f"{day_of(earliest)} to {day_of(latest)}" if latest is not None else f"{day_of(earliest)} or later"


# -- tables -----------------------------------------------------------------------------------------------------------


def arms_table(result: FleetResult) -> Table:
    """Show one row for each arm with its condition, the worst arm first."""
    began = {run.run: day_of(run.began) for run in result.runs}
    return table_of(
        "Arms, the worst first",
        result.arms.items(),
        ("condition", lambda row: row[1].condition),
        ("arm", lambda row: row[0]),
        ("runs", lambda row: len(row[1].runs), "d"),
        ("newest", lambda row: began.get(row[1].runs[-1], "")),
        ("held-out", lambda row: newest_value(row[1], "heldout"), _MM, "mm"),
        ("targets", lambda row: newest_value(row[1], "verified"), _MM, "mm"),
        ("tolerance", lambda row: row[1].tolerance_mm, _MM, "mm"),
        ("effects", lambda row: sum(effect.sizes[-1].found for effect in row[1].effects), "d"),
    )


def runs_table(result: FleetResult, most: int | None = MOST_ROWS) -> Table:
    """Show every run with its arms' figures; only the newest rows if there are more than ``most``."""
    figures: tuple[Figure, ...] = ("heldout", "verified", "check", "temperature")
    columns = (
        Column("run"),
        Column("began"),
        Column("arm"),
        number_column("held-out mean", _MM, "mm"),
        number_column("targets, largest", _MM, "mm"),
        number_column("check rms", _MM, "mm"),
        number_column("mean temp.", ".1f", "°C"),
        number_column("changed", "d"),
    )
    rows: list[tuple[Cell, ...]] = []
    for run in result.runs:
        own = [(name, arm) for name, arm in result.arms.items() if run.run in arm.runs]
        if run.problem:
            rows.append((short(run.run), "", "cannot be read", *(None for _ in figures), None))
        for name, arm in own:
            values = [_of_run(arm.figures.get(figure, ()), run.run) for figure in figures]
            changed = sum(change.proven for one in arm.parameters for change in one.changes if change.run == run.run)
            rows.append((short(run.run), day_of(run.began), name, *values, changed))
    return part_table("Runs", columns, rows if most is None else rows[-most:], len(rows))


def arm_tables(name: str, arm: ArmHistory) -> list[Table]:
    """Show an arm's changes since its first run, effects, proven trends and checks."""
    return with_rows(
        parameter_table(name, arm), effect_table(name, arm), trend_table(name, arm), check_table(name, arm)
    )


def parameter_table(name: str, arm: ArmHistory, most: int = _MOST_PARAMETERS) -> Table:
    """Show the newest differences from the first run, most significant first; base and tool are not judged."""
    compared = [one for one in arm.parameters if one.last is not None]
    chosen = most_urgent(compared, _urgency, most)
    return table_of(
        f"{name}: parameters, newest against first run",
        chosen,
        ("parameter", "name"),
        *_LAST,
        ("moves the SMR", "moved_mm", _MM, "mm"),
        ("chance", "last.p_value", ".2g"),
        ("changed", lambda one: "yes" if one.last.proven else "" if one.part == "arm" else "base or tool"),
        count=len(compared),
    )


def _urgency(one: ParameterHistory) -> float:
    assert one.last is not None
    z = abs(one.last.difference) / one.last.standard_uncertainty if one.last.standard_uncertainty else 0.0
    return z if one.part == "arm" else 0.0


_LAST: tuple[Field, ...] = (
    ("newest - first", lambda one: one.last.difference * display_unit(one.unit)[0], "+.1f"),
    ("u", lambda one: one.last.standard_uncertainty * display_unit(one.unit)[0], ".1f"),
    ("unit", lambda one: display_unit(one.unit)[1]),
)
"""Columns of a parameter's newest difference, for histories that have one."""


def effect_table(name: str, arm: ArmHistory) -> Table:
    """Show effects of the first and of the newest run."""

    def shown(one: EffectHistory, value: float | None) -> float | None:
        return None if value is None else value * (display_unit(one.unit)[0] if one.unit else 1.0)

    def size(one: EffectHistory, place: int) -> float | None:
        return [size for size in one.sizes if size.searched][place].size_mm

    return table_of(
        f"{name}: effects, newest against first search",
        arm.effects,
        ("effect", lambda one: ", ".join(filter(None, (one.effect, place_words(one.where))))),
        ("state", "state"),
        ("by", "parameter"),
        ("newest - first", lambda one: shown(one, one.difference), "+.3g"),
        ("u", lambda one: shown(one, one.standard_uncertainty), ".2g"),
        ("unit", lambda one: display_unit(one.unit)[1] if one.unit else ""),
        ("first", lambda one: size(one, 0), _MM, "mm"),
        ("newest", lambda one: size(one, -1), _MM, "mm"),
    )


def trend_table(name: str, arm: ArmHistory) -> Table:
    """Show trends of the errors, and of parameters if proven."""
    return table_of(
        f"{name}: trends",
        (trend for trend in arm.trends if trend.proven or trend.figure != "parameter"),
        ("figure", lambda one: f"parameter {one.name}" if one.figure == "parameter" else FIGURE_WORDS[one.figure]),
        ("a month", "slope", "+.4f", "mm"),
        ("standard error", "slope_standard_error", ".4f", "mm"),
        ("chance", "p_value", ".2g"),
        ("trend", lambda one: "proven" if one.proven else "not proven"),
        ("tolerance", "tolerance_mm", _MM, "mm"),
        ("reached", lambda one: f"{day_of(one.crossing.date)} ({_between(one)})" if one.crossing else ""),
    )


def check_table(name: str, arm: ArmHistory) -> Table:
    """Show stored checks and judged tests of ISO 9283, by time."""
    columns = (Column("when"), Column("what"), Column("outcome"), number_column("value", _MM, "mm"))
    rows: list[tuple[str, str, str, float | None]] = [
        (point.time, "check", "; ".join([point.verdict, *point.changes]), point.rms_mm) for point in arm.checks
    ]
    rows += [
        (point.time, f"ISO 9283 {point.characteristic.replace('_', ' ')}", point.conformity, point.value_mm)
        for point in arm.iso9283
    ]
    shown = tuple((day_of(time), *rest) for time, *rest in sorted(rows, key=lambda row: row[0]))
    return Table(f"{name}: checks and tests", columns, shown)


def pair_table(pair: PairHistory) -> Table:
    """Show the newest inter-base transform beside that of the first run."""
    return table_of(
        f"Inter-base transform of {pair.arms[0]} and {pair.arms[1]}",
        (one for one in pair.parameters if one.last is not None),
        ("parameter", "name"),
        *_LAST,
        ("chance", "last.p_value", ".2g"),
        ("changed", lambda one: "yes" if one.last.proven else ""),
    )


# -- words ------------------------------------------------------------------------------------------------------------


def pair_sentence(pair: PairHistory) -> str:
    """Say whether the bases have moved relative to each other."""
    arms = f"{pair.arms[0]} and {pair.arms[1]}"
    if not pair.distances_mm:
        return f"{arms}: their inter-base transforms were not made by a common method"
    if pair.moved:
        return f"{arms}: their bases have moved against each other, by {pair.distances_mm[-1].value:.3f} mm"
    return f"{arms}: no motion of their bases against each other is proven"


def effect_words(effect: EffectHistory) -> str:
    """Describe an effect that has another name in the other run."""
    others = ", ".join(effect.instead_of)
    return f"{effect.title}: its data cannot be told from {others} of the other run; not counted as a change"


def newest_value(arm: ArmHistory, figure: Figure) -> float | None:
    """Return the newest value of a figure; None if there is none."""
    values = arm.figures.get(figure, ())
    return values[-1].value if values else None


def short(run: str) -> str:
    """Return the last two parts of a folder's path."""
    return "/".join(Path(run).parts[-2:])


def _of_run(values: tuple[DatedValue, ...], run: str) -> float | None:
    own = [value.value for value in values if value.run == run]
    return own[-1] if own else None
