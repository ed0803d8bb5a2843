"""The result of ``check`` as tables and sentences."""

from __future__ import annotations

from cellapp.commands.check.charts import check_charts
from cellapp.commands.check.request import CheckRequest
from cellapp.commands.record import View
from cellapp.commands.view.parts import Part
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.estimation.monitoring.check.records import TRACKER, CheckResult, FoundChange, WeakChange
from cellapp.ground.counting import counted

_VERDICTS = {
    "valid": "the calibration still holds",
    "tracker moved": "the tracker moved; the arms are as they were calibrated",
    "base moved": "the base of an arm moved",
    "smr moved": "the SMR of an arm sits elsewhere on its flange",
    "arm changed": "an arm changed",
    "not explained": "something changed, and no change that was tried explains it",
    "cannot say": "whether the calibration holds is not known",
}


_UNITS = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}
_LEAST_CHANCE = 1e-12
"""Smaller probabilities mean nothing: no error of measuring is normal as far out as that."""


def view(result: CheckResult, request: CheckRequest | None = None) -> View:
    """What was measured, the verdict, the evidence, and why the calibration does not hold."""
    strict = request is not None and request.strict
    parts: tuple[Part, ...] = (*check_tables(result), *check_sentences(result), *check_charts(result))
    return View(parts, result.complaints(strict=strict), held="the calibration holds")


def check_tables(result: CheckResult) -> list[Table]:
    """Errors of each arm, what changed, what these stops would show too weakly, and every stop."""
    return [_arm_table(result), *_change_tables(result), *_weak_tables(result), *_stop_tables(result)]


def check_sentences(result: CheckResult) -> list[str]:
    """The verdict, how sure it is, what moved and by how much, the accuracy that is left, and what to do now."""
    return [
        verdict_sentence(result),
        evidence_sentence(result),
        *_station_sentences(result),
        *(change_sentence(one) for one in result.changes),
        *[
            f"arm {name}: predictions of the stored model are off by {arm.left_mm:.3f} mm rms over the calibration's"
            " readings, without the noise of measuring"
            for name, arm in result.arms.items()
            if arm.left_mm is not None
        ],
        *(["the hidden physics of another profile was simulated for this check"] if result.simulated else []),
        *([f"next: {result.next_step}"] if result.next_step else []),
        *result.notes,
    ]


def verdict_sentence(result: CheckResult) -> str:
    """The verdict in words, with how many stops it took."""
    took = "" if result.seconds is None else f" in {result.seconds:.0f} s"
    what = ", ".join(one.words for one in result.changes if one.words != TRACKER)
    found = f" ({what})" if what else ""
    return (
        f"{_VERDICTS[result.verdict]}{found}: {len(result.stops)} of"
        f" {counted(result.planned, 'stop was', 'stops were')} measured{took}"
    )


def evidence_sentence(result: CheckResult) -> str:
    """The chance of the errors without a change, and what the test promises."""
    return (
        f"probability of errors as large if nothing had changed: {_chance(result.p_value)}; the test takes a cell that"
        f" did not change for changed in {100.0 * result.false_alarm:g} % of checks, and misses a visible change in"
        f" {100.0 * result.miss:g} %"
    )


def change_sentence(change: FoundChange) -> str:
    """What changed, by how much, and how sure that is."""
    amount = "" if change.value is None else f" by {_amount(change)}"
    return (
        f"{change.words}{amount}: it moves the SMR by {change.moved_mm:.3f} mm rms over the calibration's readings"
        f" (p {_chance(change.p_value)})"
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _shown(change: FoundChange) -> tuple[float | None, float | None, str]:
    """Amount, standard error and unit for people: lengths in mm, angles in mrad."""
    scale, unit = _UNITS.get(change.unit, (1.0, change.unit))
    error = None if change.standard_error is None else change.standard_error * scale
    return None if change.value is None else change.value * scale, error, unit


def _detected(change: WeakChange) -> tuple[float, str]:
    scale, unit = _UNITS.get(change.unit, (1.0, change.unit))
    return change.detected * scale, unit


def _amount(change: FoundChange) -> str:
    value, error, unit = _shown(change)
    return f"{value:.4g}{'' if error is None else f' +- {error:.2g}'} {unit}".rstrip()


def _chance(p_value: float) -> str:
    return f"< {_LEAST_CHANCE:g}" if p_value < _LEAST_CHANCE else f"{p_value:.2g}"


def _station_sentences(result: CheckResult) -> list[str]:
    if result.verdict != "tracker moved" or result.station_shift_mm is None or result.station_turn_deg is None:
        return []
    return [f"it stands {result.station_shift_mm:.3f} mm and {result.station_turn_deg:.4f} deg from where it was"]


def _arm_table(result: CheckResult) -> Table:
    columns = (
        Column("arm"),
        number_column("stops", "d"),
        number_column("expected", ".3f"),
        number_column("measured", ".3f"),
        number_column("of the model alone", ".3f"),
    )
    rows: list[tuple[Cell, ...]] = [
        (name, arm.stops, arm.expected_mm, arm.rms_mm, arm.left_mm) for name, arm in result.arms.items()
    ]
    return Table(
        "Check: rms position errors at the stops, and of the model over the readings [mm]",
        columns,
        tuple(rows),
    )


def _change_tables(result: CheckResult) -> list[Table]:
    if not result.changes:
        return []
    columns = (
        Column("where"),
        Column("what"),
        number_column("change", ".4g"),
        number_column("standard error", ".2g"),
        Column("unit"),
        number_column("SMR moves [mm]", ".3f"),
        Column("p"),
        Column("explains about as well"),
    )
    rows: list[tuple[Cell, ...]] = [
        (one.arm, one.what, *_shown(one), one.moved_mm, _chance(one.p_value), ", ".join(one.rivals) or "nothing")
        for one in result.changes
    ]
    return [Table("Check: what changed", columns, tuple(rows))]


def _weak_tables(result: CheckResult) -> list[Table]:
    """Visible changes that would have to be larger to be found."""
    if not result.weak:
        return []
    columns = (Column("where"), Column("what"), number_column("found from", ".2g"), Column("unit"))
    rows = tuple((one.arm, one.what, *_detected(one)) for one in result.weak)
    return [Table("Check: visible changes that these stops may miss", columns, rows)]


def _stop_tables(result: CheckResult) -> list[Table]:
    if not result.stops:
        return []
    columns = (
        number_column("stop", "d"),
        number_column("time [s]", ".0f"),
        *(number_column(f"{name} [mm]", ".3f") for name in result.arms),
        number_column("evidence of a change", ".2f"),
        number_column("evidence of none", ".2f"),
        Column("p"),
    )
    rows = tuple(
        (
            number,
            stop.time_s,
            *(stop.points[name].error_mm if name in stop.points else None for name in result.arms),
            stop.log_evidence,
            stop.log_valid,
            _chance(stop.p_value),
        )
        for number, stop in enumerate(result.stops, start=1)
    )
    return [Table("Check: errors and evidence stop by stop", columns, rows)]
