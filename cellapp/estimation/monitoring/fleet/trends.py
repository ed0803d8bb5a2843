"""Trends of one arm: errors and drifting parameters over time, and when they reach the tolerance."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal

import numpy as np

from cellapp.estimation.monitoring.fleet.records import Crossing, DatedValue, Figure, Trend, TrendFigure
from cellapp.estimation.monitoring.fleet.trend import Line, crossing, fit_line

MONTH_DAYS = 30.4375
"""A twelfth of 365.25 days."""
_FARTHEST_DAYS = 36525.0
"""A hundred years: a trend says nothing about what is farther off."""
_DAY_S = 86400.0
_LEAST_SPAN_DAYS = 1.0
"""Values of one day say nothing about months: what changes within hours is warming up."""
_FOLLOWED: tuple[Literal["heldout", "verified", "check"], ...] = ("heldout", "verified", "check")
_WITH_TOLERANCE: frozenset[TrendFigure] = frozenset({"verified", "parameter"})
"""The tolerance limits the largest error at a target, and by how much a parameter may move the SMR unnoticed; the other
figures are means."""


@dataclass(frozen=True)
class _Fitted:
    """A figure over time with its line."""

    figure: TrendFigure
    name: str
    points: tuple[DatedValue, ...]
    line: Line


@dataclass(frozen=True)
class ArmTrends:
    """Fitted lines of one arm, and its tolerance [mm]."""

    lines: tuple[_Fitted, ...]
    tolerance_mm: float | None


def draft_trends(
    figures: Mapping[Figure, Sequence[DatedValue]],
    drifts: Mapping[str, Sequence[DatedValue]],
    tolerance_mm: float | None,
) -> ArmTrends:
    """Lines through every figure [mm] and every parameter's displacement [mm] that has enough values."""
    followed: list[tuple[TrendFigure, str, Sequence[DatedValue]]] = [
        (figure, "", figures[figure]) for figure in _FOLLOWED if figure in figures
    ]
    followed += [("parameter", name, points) for name, points in drifts.items()]
    lines = []
    for figure, name, points in followed:
        line = _fit(points)
        if line is not None:
            lines.append(_Fitted(figure, name, tuple(points), line))
    return ArmTrends(tuple(lines), tolerance_mm)


def trend_results(
    trends: ArmTrends, corrected: Callable[[float | None], float | None], proves: Callable[[float | None], bool]
) -> tuple[Trend, ...]:
    """The lines as results; a tolerance is only reached by a trend that is proven."""
    return tuple(
        _result(one, trends.tolerance_mm, corrected(one.line.p_value) or 0.0, proves(one.line.p_value))
        for one in trends.lines
    )


def _fit(points: Sequence[DatedValue]) -> Line | None:
    if not points:
        return None
    errors = [point.standard_error for point in points]
    known = None if any(error is None for error in errors) else np.array(errors, dtype=np.float64)
    days = np.array([days_since_1970(point.time) for point in points])
    if np.ptp(days) < _LEAST_SPAN_DAYS:
        return None
    return fit_line(days, np.array([point.value for point in points]), known)


def _result(one: _Fitted, tolerance_mm: float | None, p_value: float, proven: bool) -> Trend:
    line = one.line
    limit = tolerance_mm if one.figure in _WITH_TOLERANCE else None
    reached = None if limit is None or not proven else _crossing(one, limit)
    return Trend.like(
        line,
        figure=one.figure,
        name=one.name,
        points=one.points,
        origin=_date(line.origin),
        slope=line.slope * MONTH_DAYS,
        slope_standard_error=line.slope_standard_error * MONTH_DAYS,
        p_value=p_value,
        proven=proven,
        tolerance_mm=limit,
        crossing=reached,
    )


def _crossing(one: _Fitted, tolerance_mm: float) -> Crossing | None:
    """When an error reaches the tolerance, or a parameter has moved the SMR by it since the newest calibration."""
    newest = max(days_since_1970(point.time) for point in one.points)
    line = one.line
    if one.figure == "parameter":
        since = Line(newest, 0.0, line.slope, 0.0, line.slope_standard_error, line.degrees_of_freedom)
        time, earliest, latest = crossing(since, tolerance_mm if line.slope > 0.0 else -tolerance_mm)
    elif line.slope <= 0.0:
        return None
    else:
        time, earliest, latest = crossing(line, tolerance_mm)
    if not newest <= time <= newest + _FARTHEST_DAYS:
        return None
    return Crossing(
        tolerance_mm=tolerance_mm,
        date=_date(time),
        months=(time - newest) / MONTH_DAYS,
        earliest=None if earliest is None else _date(max(earliest, newest)),
        latest=None if latest is None or latest > newest + _FARTHEST_DAYS else _date(latest),
    )


def days_since_1970(time: str) -> float:
    """Days since 1970 of a time (ISO 8601)."""
    moment = datetime.fromisoformat(time)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp() / _DAY_S


def _date(days: float) -> str:
    return (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(days=days)).isoformat(timespec="seconds")
