"""First figure of the page: errors before and after on one logarithmic axis, as data for its template."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from cellapp.cell.targets.records import ArmVerification
from cellapp.commands.report.data import ReportData
from cellapp.commands.view.charts import SMALLEST_MM, mm
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.ground.counting import counted
from cellapp.ground.results import BEST_METHODS, CALIBRATE, ErrorSummary, Method

_ROOM = 1.25
"""Factor by which the axis reaches beyond the smallest and the largest value."""

_FEW_DECADES = 4
"""Most decades of an axis with ticks at three times each power of ten: more have no room on a phone."""


@dataclass(frozen=True)
class ComparedErrors:
    """Mean errors [mm] of one arm or of the pair before and after, the largest error after, and the tolerance if any.

    ``source`` says where they were measured.
    """

    label: str
    source: str
    before_mm: float
    after_mm: float
    largest_mm: float
    tolerance_mm: float | None = None

    @property
    def words(self) -> str:
        """Both errors, as ``4.04 mm -> 0.026 mm``."""
        return f"{mm(self.before_mm)} \N{RIGHTWARDS ARROW} {mm(self.after_mm)}"


@dataclass(frozen=True)
class BeforeAfterFigure:
    """Rows on a common logarithmic axis from ``low_mm`` to ``high_mm``; ``message`` says what they show."""

    rows: tuple[ComparedErrors, ...]
    low_mm: float
    high_mm: float
    message: str

    def percent(self, value_mm: float) -> str:
        """Return the place of a value on the axis, as a percentage of its length for SVG."""
        share = math.log(max(value_mm, self.low_mm) / self.low_mm) / math.log(self.high_mm / self.low_mm)
        return f"{100.0 * share:.2f}%"

    @property
    def ticks(self) -> tuple[float, ...]:
        """Powers of ten on the axis [mm], and three times them if there is room."""
        first, last = math.floor(math.log10(self.low_mm)), math.ceil(math.log10(self.high_mm))
        steps = (1.0, 3.0) if last - first <= _FEW_DECADES else (1.0,)
        ticks = [step * 10.0**exponent for exponent in range(first, last + 1) for step in steps]
        return tuple(tick for tick in ticks if self.low_mm <= tick <= self.high_mm)


def before_after_figure(data: ReportData) -> BeforeAfterFigure | None:
    """Compare the nominal and the best model of every arm and of the pair; None if no errors of both are known.

    Errors are those measured at verified targets; without these, those at held-out configurations.
    """
    rows = [row for name in data.calibrate.arms if (row := _arm_row(data, name)) is not None]
    pair = _pair_row(data)
    rows += [] if pair is None else [pair]
    if not rows:
        return None
    values = [value for row in rows for value in (row.before_mm, row.after_mm, row.largest_mm)]
    values += [row.tolerance_mm for row in rows if row.tolerance_mm is not None]
    low, high = max(min(values), SMALLEST_MM) / _ROOM, max(*values, SMALLEST_MM) * _ROOM
    outdated = "Out of date. " if CALIBRATE in data.out_of_date else ""
    return BeforeAfterFigure(tuple(rows), low, high, outdated + _message(rows))


def _arm_row(data: ReportData, name: str) -> ComparedErrors | None:
    tolerance = _millimetres(data.profile.tolerances.position)
    verified = None if data.verify is None else data.verify.arms.get(name)
    if verified is not None:
        return _verified_row(f"Arm {name}", verified, tolerance)
    arm = data.calibrate.arms[name]
    errors = arm.validate_
    if "nominal" not in errors or not arm.converged:
        return None
    best = errors[arm.best_stage].position_mm
    return _row(
        f"Arm {name}", counted(best.n, "held-out configuration"), errors["nominal"].position_mm, best, tolerance
    )


def _pair_row(data: ReportData) -> ComparedErrors | None:
    tolerance = _millimetres(data.profile.tolerances.cooperative)
    if data.verify is not None and data.verify.cooperative is not None:
        return _verified_row("Both arms, distance", data.verify.cooperative, tolerance)
    best = best_method(data.calibrate)
    if best is None or "nominal" not in data.calibrate.pair:
        return None
    errors = data.calibrate.pair[best].cooperative_mm
    nominal = data.calibrate.pair["nominal"].cooperative_mm
    return _row("Both arms, distance", counted(errors.n, "held-out stop"), nominal, errors, tolerance)


def best_method(calibrate: CalibrateResult) -> Method | None:
    """Return the best model of the pair that was computed; None without a pair."""
    return next((method for method in BEST_METHODS if method in calibrate.pair), None)


def _verified_row(label: str, verified: ArmVerification, tolerance: float | None) -> ComparedErrors:
    after = verified.compensated_mm
    return _row(label, f"{after.n} verified targets", verified.nominal_mm, after, tolerance)


def _row(
    label: str, source: str, before: ErrorSummary, after: ErrorSummary, tolerance_mm: float | None
) -> ComparedErrors:
    return ComparedErrors(label, source, before.mean, after.mean, after.max, tolerance_mm)


def _message(rows: Sequence[ComparedErrors]) -> str:
    worse = [row.label for row in rows if row.after_mm >= row.before_mm]
    if worse:
        return f"The mean error did not fall: {', '.join(worse)}."
    factors = [row.before_mm / max(row.after_mm, SMALLEST_MM) for row in rows]
    low, high = _factor(min(factors)), _factor(max(factors))
    times = f"{low} times" if low == high else f"{low} to {high} times"
    return f"The mean error is {times} smaller than with the nominal model."


def _factor(value: float) -> str:
    return f"{value:.0f}" if value >= 9.5 else f"{value:.1f}"


def _millimetres(length_m: float | None) -> float | None:
    return None if length_m is None else length_m * 1e3
