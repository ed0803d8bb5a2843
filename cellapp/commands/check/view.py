"""The results of ``check`` as tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Callable

from cellapp.commands.check.request import CheckRequest
from cellapp.commands.record import View
from cellapp.commands.view.parts import Part
from cellapp.commands.view.table import Table, table_of, table_of_cells, with_rows, without_empty
from cellapp.estimation.monitoring.records import TRACKER, CheckedStop, CheckResult, FoundChange, LocateResult
from cellapp.ground.counting import counted

_VERDICTS = {
    "valid": "the calibration still holds",
    "tracker moved": "the tracker moved; the arms are as they were calibrated",
    "base moved": "the base of an arm moved",
    "smr moved": "the SMR of an arm sits elsewhere on its flange",
    "arm changed": "an arm changed",
    "not explained": "something changed, and no change that was tried explains it",
    "not decided": "whether the calibration holds is not known",
}


_UNITS = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}
_LEAST_CHANCE = 1e-12
"""Least probability that is stated: measuring errors are not normal so far out."""


def view(result: CheckResult | LocateResult, request: CheckRequest | None = None) -> View:
    """Show what was measured, the verdict, the evidence, and why the calibration does not hold."""
    if isinstance(result, LocateResult):
        return location_view(result)
    strict = request is not None and request.strict
    parts: tuple[Part, ...] = (*check_tables(result), *check_sentences(result))
    return View(parts, result.complaints(strict=strict), held="the calibration holds")


def location_view(result: LocateResult) -> View:
    """Show every point, the tracker's station, and why it could not be located."""
    parts: tuple[Part, ...] = (*location_tables(result), *location_sentences(result))
    return View(parts, result.complaints(), "location", held="the tracker was located")


def location_tables(result: LocateResult) -> list[Table]:
    """Show every measured point with its residual."""
    rows = (
        (point.arm, point.found_off_mm, *point.residual_mm, math.hypot(*point.residual_mm)) for point in result.points
    )
    residuals = *((f"residual {axis}", ".3f") for axis in "xyz"), ("residual", ".3f")
    title = "Station of the tracker: measured points [mm]"
    return [table_of_cells(title, rows, "arm", ("found off", ".1f"), *residuals)]


def location_sentences(result: LocateResult) -> list[str]:
    """State the tracker's station, its uncertainty, and whether the points are consistent."""
    test = (
        f"residuals {result.rms_mm:.3f} mm rms; chi-squared {result.chi_squared:.1f} of {result.degrees_of_freedom}"
        f" degrees of freedom, probability {result.probability:.2g}"
    )
    if result.verdict != "located":
        return [f"not located: {test}", *result.complaints(), *result.notes]
    place = ", ".join(f"{value:z.4f}" for value in result.tracker_pose.position)
    angles = ", ".join(f"{math.degrees(value):z.3f}" for value in result.tracker_pose.rpy)
    what = "moved" if result.moved else "not moved beyond the limit of drift: it stands"
    by = f"{result.shift_mm:.2f} mm and {result.turn_deg:.4f} deg from where the readings were taken"
    return [
        f"the tracker was {what} {by}",
        f"it stands at ({place}) m in the cell, roll, pitch, yaw ({angles}) deg",
        f"the station adds {result.uncertainty_mm:.4f} mm of standard uncertainty to a coordinate; {test}",
        *result.notes,
    ]


def check_tables(result: CheckResult) -> list[Table]:
    """Show each arm's errors, what changed, and errors and evidence stop by stop."""
    return [_arm_table(result), *with_rows(_change_table(result), _stop_table(result))]


def check_sentences(result: CheckResult) -> list[str]:
    """State the verdict, its certainty, where a moved tracker stands, and what to do."""
    shift_mm, turn_deg = result.station_shift_mm, result.station_turn_deg
    moved = result.verdict == "tracker moved" and shift_mm is not None and turn_deg is not None
    return [
        verdict_sentence(result),
        evidence_sentence(result),
        *([f"it stands {shift_mm:.3f} mm and {turn_deg:.4f} deg from where it was"] if moved else []),
        *(["the hidden physics of another profile was simulated for this check"] if result.simulated else []),
        *([f"next: {result.next_step}"] if result.next_step else []),
        *result.notes,
    ]


def verdict_sentence(result: CheckResult) -> str:
    """State the verdict, and after how many stops it was reached."""
    took = "" if result.seconds is None else f" in {result.seconds:.0f} s"
    what = ", ".join(one.words for one in result.changes if one.words != TRACKER)
    found = f" ({what})" if what else ""
    return (
        f"{_VERDICTS[result.verdict]}{found}: {len(result.stops)} of"
        f" {counted(result.planned, 'stop was', 'stops were')} measured{took}"
    )


def evidence_sentence(result: CheckResult) -> str:
    """State the probability of the errors without a change, and the error rates of the test."""
    return (
        f"probability of errors as large if nothing had changed: {_chance(result.p_value)}; the test takes a cell that"
        f" did not change for changed in {100.0 * result.false_alarm:g} % of checks, and misses a visible change in"
        f" {100.0 * result.miss:g} %"
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _in_unit(change: FoundChange, value: float | None) -> float | None:
    """Return a value of a change in mm for lengths, in mrad for angles."""
    return None if value is None else value * _UNITS.get(change.unit, (1.0, ""))[0]


def _chance(p_value: float) -> str:
    return f"< {_LEAST_CHANCE:g}" if p_value < _LEAST_CHANCE else f"{p_value:.2g}"


def _arm_table(result: CheckResult) -> Table:
    rotated = (
        ("expected [mrad]", lambda row: row[1].expected_mrad, ".3f"),
        ("measured [mrad]", lambda row: row[1].rms_mrad, ".3f"),
    )
    return table_of(
        "Check: rms position errors at the stops, and of the model over the readings [mm]",
        result.arms.items(),
        ("arm", lambda row: row[0]),
        ("stops", lambda row: row[1].stops, "d"),
        ("expected", lambda row: row[1].expected_mm, ".3f"),
        ("measured", lambda row: row[1].rms_mm, ".3f"),
        ("of the model alone", lambda row: row[1].left_mm, ".3f"),
        *(rotated if any(one.rms_mrad is not None for one in result.arms.values()) else ()),
    )


def _change_table(result: CheckResult) -> Table:
    return table_of(
        "Check: what changed",
        result.changes,
        ("where", "arm"),
        ("what", "what"),
        ("change", lambda one: _in_unit(one, one.value), ".4g"),
        ("standard error", lambda one: _in_unit(one, one.standard_error), ".2g"),
        ("unit", lambda one: _UNITS.get(one.unit, (1.0, one.unit))[1]),
        ("SMR moves [mm]", "moved_mm", ".3f"),
        *((("probe rotates [mrad]", "turned_mrad", ".3f"),) if any(one.turned_mrad for one in result.changes) else ()),
        ("p", lambda one: _chance(one.p_value)),
        ("explains about as well", lambda one: ", ".join(one.rivals) or "nothing"),
    )


def _stop_table(result: CheckResult) -> Table:
    """Show which stop, and which arm there, stands out."""

    def error(name: str, of: str) -> Callable[[tuple[int, CheckedStop]], float | None]:
        return lambda row: getattr(row[1].points.get(name), of, None)

    table = table_of(
        "Check: errors and evidence stop by stop",
        enumerate(result.stops, start=1),
        ("stop", lambda row: row[0], "d"),
        *((name, error(name, "error_mm"), ".3f", "mm") for name in result.arms),
        *((name, error(name, "error_mrad"), ".3f", "mrad") for name in result.arms),
        ("evidence of a change", lambda row: row[1].log_evidence, ".2f"),
        ("evidence of none", lambda row: row[1].log_valid, ".2f"),
        ("p", lambda row: _chance(row[1].p_value)),
    )
    return without_empty(table)
