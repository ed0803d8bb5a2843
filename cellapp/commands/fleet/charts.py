"""Charts of an arm over its runs: errors with their trends, parameters with bands, sizes of effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from cellapp.commands.fleet.view import trend_words
from cellapp.commands.view.charts import Axis, Chart, Limit, Series, series
from cellapp.commands.view.words import TWO_SIDED, display_unit
from cellapp.estimation.monitoring.fleet.condition import FIGURE_WORDS
from cellapp.estimation.monitoring.fleet.records import (
    ArmHistory,
    DatedValue,
    Figure,
    PairHistory,
    ParameterHistory,
    Trend,
)
from cellapp.estimation.monitoring.fleet.trend import CONFIDENCE, Line
from cellapp.estimation.monitoring.fleet.trends import MONTH_DAYS, days_since_1970

MOST_PARAMETERS = 6
"""Most parameters of an arm with a chart: those that changed or drift, then those closest to a change."""
_LINE_POINTS = 60
_FARTHEST = 3.0
"""How far a trend is drawn beyond its values, at most, in spans of these."""
_CONDITIONS: tuple[tuple[str, Axis, tuple[Figure, ...]], ...] = (
    (
        "Noise and repeatability",
        Axis("length", "mm"),
        ("noise", "repeatability", "pose_accuracy", "pose_repeatability"),
    ),
    ("Temperature at the stops", Axis("temperature", "°C"), ("temperature",)),
)


def trend_charts(arm: ArmHistory) -> list[Chart]:
    """Show every followed error with its trend line, and every parameter with a proven drift."""
    return [_trend_chart(trend) for trend in arm.trends if trend.figure != "parameter" or trend.proven]


def condition_charts(arm: ArmHistory) -> list[Chart]:
    """Show noise and repeatability in one chart, the temperature in another; only those with at least two runs."""
    known = {figure: values for figure, values in arm.figures.items() if len(values) > 1}
    return [
        _values_chart(title, axis, {figure: known[figure] for figure in figures if figure in known})
        for title, axis, figures in _CONDITIONS
        if any(figure in known for figure in figures)
    ]


def _values_chart(title: str, axis: Axis, values: Mapping[Figure, Sequence[DatedValue]]) -> Chart:
    start = _start([one.time for rows in values.values() for one in rows])
    drawn = tuple(
        series(
            FIGURE_WORDS[figure],
            [days_since_1970(one.time) - start for one in rows],
            [one.value for one in rows],
            style=k,
        )
        for k, (figure, rows) in enumerate(values.items())
    )
    newest = "; ".join(f"{FIGURE_WORDS[figure]} {rows[-1].value:.3g} {axis.unit}" for figure, rows in values.items())
    return Chart(title, _days(start), axis, tuple(drawn), f"Newest values: {newest}.")


def parameter_charts(arm: ArmHistory) -> list[Chart]:
    """Show differences from the first run with 95 % bands, of the most significant parameters."""
    changed = [one for one in arm.parameters if one.changes and one.part == "arm"]
    chosen = sorted(changed, key=_chance)[:MOST_PARAMETERS]
    return [_parameter_chart(one) for one in chosen]


def effect_chart(arm: ArmHistory) -> Chart | None:
    """Show sizes of all effects over time; zero if a search did not find one. None without effects."""
    drawn: list[Series] = []
    start = _start([size.time for effect in arm.effects for size in effect.sizes])
    for number, effect in enumerate(arm.effects):
        known = [size for size in effect.sizes if size.searched and (size.size_mm is not None or not size.found)]
        if known:
            days = [days_since_1970(size.time) - start for size in known]
            drawn.append(series(effect.effect, days, [size.size_mm or 0.0 for size in known], style=number))
    if not drawn:
        return None
    states = "; ".join(f"{effect.effect} {effect.state}" for effect in arm.effects)
    return Chart(
        "Effects: rms displacement of the SMR over held-out stops",
        _days(start),
        Axis("size", "mm"),
        tuple(drawn),
        f"From the first search to the newest: {states}.",
    )


def pair_chart(pair: PairHistory) -> Chart | None:
    """Show the displacement of the second base in the frame of the first; None if fewer than two runs have it."""
    if not pair.distances_mm or not pair.parameters:
        return None
    first = pair.parameters[0].first
    points = [(first.time, 0.0), *((one.time, one.value) for one in pair.distances_mm)]
    start = _start([time for time, _ in points])
    moved = "is proven" if pair.moved else "is not proven"
    return Chart(
        "Origin of the second base in the frame of the first: distance from that of the first run",
        _days(start),
        Axis("distance", "mm"),
        (series("distance", [days_since_1970(time) - start for time, _ in points], [value for _, value in points]),),
        f"A motion of the bases against each other {moved} in the newest run.",
    )


def _trend_chart(trend: Trend) -> Chart:
    start = _start([point.time for point in trend.points])
    days = np.array([days_since_1970(point.time) - start for point in trend.points])
    values = np.array([point.value for point in trend.points])
    name = f"displacement by {trend.name}" if trend.figure == "parameter" else FIGURE_WORDS[trend.figure]
    line = _line(trend, start)
    times = np.linspace(days.min(), _end(trend, days, start), _LINE_POINTS)
    words = trend_words(trend) if trend.proven else f"no trend of the {name} is proven"
    tolerance = trend.tolerance_mm
    limits = () if tolerance is None else (Limit(f"tolerance, {tolerance:g} mm", tolerance),)
    return Chart(
        f"{name[:1].upper()}{name[1:]} over time",
        _days(start),
        Axis("displacement" if trend.figure == "parameter" else "error", "mm"),
        (
            series("line", times, line.at(times), band=line.half_width(times, CONFIDENCE), style=1),
            series("values", days, values, "points", style=0),
        ),
        f"{words[:1].upper()}{words[1:]}.",
        limits=limits if trend.figure != "parameter" else (),
    )


def _line(trend: Trend, start: float) -> Line:
    return Line(
        days_since_1970(trend.origin) - start,
        trend.level,
        trend.slope / MONTH_DAYS,
        trend.level_standard_error,
        trend.slope_standard_error / MONTH_DAYS,
        trend.degrees_of_freedom,
    )


def _end(trend: Trend, days: np.ndarray, start: float) -> float:
    """Return the end of the trend line: the newest value, or the crossing of the tolerance if that is near."""
    newest = float(days.max())
    if trend.crossing is None:
        return newest
    reached = days_since_1970(trend.crossing.date) - start
    return min(reached, newest + _FARTHEST * float(np.ptp(days)))


def _parameter_chart(one: ParameterHistory) -> Chart:
    factor, unit = display_unit(one.unit)
    start = _start([one.first.time, *(change.time for change in one.changes)])
    days = [days_since_1970(time) - start for time in (one.first.time, *(change.time for change in one.changes))]
    differences = [0.0, *(change.difference * factor for change in one.changes)]
    bands = [0.0, *(TWO_SIDED * change.standard_uncertainty * factor for change in one.changes)]
    last = one.changes[-1]
    moved = "" if one.moved_mm is None else f"; it moves the SMR by {one.moved_mm:.3f} mm (rms)"
    verdict = "is proven" if last.proven else "is not proven"
    return Chart(
        f"{one.name}: difference from the first run",
        _days(start),
        Axis("difference", unit),
        (
            series(one.name, days, differences, band=bands, style=0),
            series("runs", days, differences, "points", style=0),
        ),
        f"{last.difference * factor:+.1f} {unit} in the newest run{moved}. A change {verdict}.",
        limits=(Limit("no change", 0.0),),
    )


def _chance(one: ParameterHistory) -> tuple[float, float]:
    """Return a sort key: smallest probability of a change first, then by size in standard uncertainties."""
    chances = [change.p_value for change in one.changes if change.p_value is not None]
    largest = max(abs(c.difference) / c.standard_uncertainty if c.standard_uncertainty else 0.0 for c in one.changes)
    return min(chances, default=1.0), -largest


def _start(times: Sequence[str]) -> float:
    return min((days_since_1970(time) for time in times), default=0.0)


def _days(start: float) -> Axis:
    return Axis(f"days since {datetime.fromtimestamp(start * 86400.0, UTC).date()}")
