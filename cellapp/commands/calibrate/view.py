"""Accuracy tables of calibration and verification, for terminal, TUI and page."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cellapp.commands.calibrate.motion_view import motion_sentences, motion_tables
from cellapp.commands.calibrate.network_view import network_sentences
from cellapp.commands.calibrate.prior_view import prior_sentences, prior_tables
from cellapp.commands.calibrate.request import CalibrateRequest
from cellapp.commands.calibrate.torque_view import torque_sentences, torque_tables
from cellapp.commands.record import Request, View
from cellapp.commands.view.table import Cell, Column, Interval, Table, number_column
from cellapp.commands.view.words import METHOD_WORDS, geometry_unit
from cellapp.estimation.calibration.records import ArmCalibrationResult, CalibrateResult
from cellapp.ground.counting import counted
from cellapp.ground.results import METHODS, STAGES, ErrorSummary

MM = ".4f"
"""Number format of errors in mm: a tenth of a micrometre, below the tracker's resolution."""

ERROR_COLUMNS = (
    *(number_column(title, MM) for title in ("mean", "rms", "std", "max")),
    number_column("n", "d"),
)
_DETAILED_COLUMNS = (
    *(number_column(title, MM) for title in ("mean", "95 % of mean", "rms", "std", "p50", "p95", "max")),
    number_column("n", "d"),
)
_TRANSFORMS = {"distances": "distances alone", "tracker": "the tracker frame"}
_PAIRS = "between arms"
_PAIR_TITLE = "Pair: held-out cooperative errors [mm]"


def view(result: CalibrateResult, request: Request | None = None) -> View:
    """Show held-out errors, the parameters on request, and the tracker's own uncertainty beside them."""
    parameters = isinstance(request, CalibrateRequest) and request.parameters
    shown = parameters_view(result).parts if parameters else ()
    return View((*calibration_tables(result), *shown, *tracker_sentences(result), *result.notes))


def parameters_view(result: CalibrateResult) -> View:
    """Show identified parameters, and which parameters were merged into others."""
    return View((*parameter_tables(result), *merged_sentences(result)))


def calibration_tables(result: CalibrateResult) -> list[Table]:
    """Show held-out errors by stage of each arm and by method of the pair, further tables, priors and changes."""
    tables = []
    for name, arm in result.arms.items():
        rows = [(label, *error_cells(summary)) for label, _, summary in _stage_summaries(arm)]
        tables.append(Table(_arm_title(name, arm), (Column("stage, measure"), *ERROR_COLUMNS), tuple(rows)))
    if result.pair:
        rows = [
            (METHOD_WORDS[method], *error_cells(result.pair[method].cooperative_mm))
            for method in METHODS
            if method in result.pair
        ]
        tables.append(Table(_PAIR_TITLE, (Column("method"), *ERROR_COLUMNS), tuple(rows)))
    return [*tables, *_tables_of_kinds(result)]


def _tables_of_kinds(result: CalibrateResult) -> list[Table]:
    """Show results from recordings of motion and torques, and the priors."""
    return [*motion_tables(result), *torque_tables(result), *prior_tables(result)]


def detailed_tables(result: CalibrateResult) -> list[Table]:
    """Build ``calibration_tables`` with percentiles, the 95 % interval of each mean, and the ratio to the tracker's
    noise.

    The ratio is the rms error over the rms error that the tracker's stated uncertainty alone would cause.
    """
    columns = (*_DETAILED_COLUMNS, number_column("rms / tracker", ".1f"))
    tables = []
    for name, arm in result.arms.items():
        noise_mm = {"position": arm.tracker_mm or None, "distance": distance_mm(arm.tracker_mm, arm.tracker_mm)}
        rows = [
            (label, *_detailed_cells(summary), _ratio(summary, noise_mm.get(measure)))
            for label, measure, summary in _stage_summaries(arm)
        ]
        tables.append(Table(_arm_title(name, arm), (Column("stage, measure"), *columns), tuple(rows)))
    if result.pair:
        noise = cooperative_noise_mm(result)
        summaries = {method: result.pair[method].cooperative_mm for method in METHODS if method in result.pair}
        rows = [
            (METHOD_WORDS[key], *_detailed_cells(errors), _ratio(errors, noise)) for key, errors in summaries.items()
        ]
        tables.append(Table(_PAIR_TITLE, (Column("method"), *columns), tuple(rows)))
    return [*tables, *_tables_of_kinds(result)]


def transform_tables(result: CalibrateResult) -> list[Table]:
    """Show cooperative errors with either inter-base transform on the same held-out stops; empty without a pair."""
    rows = [
        (f"{METHOD_WORDS[method]}, by {_TRANSFORMS[transform]}", *_detailed_cells(summary))
        for method in METHODS
        if method in result.pair
        for transform, summary in result.pair[method].by_transform_mm.items()
    ]
    if not rows:
        return []
    columns = (Column("method, transform"), *_DETAILED_COLUMNS)
    return [Table("Pair: cooperative errors by either transform [mm]", columns, tuple(rows))]


def parameter_tables(result: CalibrateResult) -> list[Table]:
    """Show identified parameters with standard errors, one table for each arm."""
    columns = (
        Column("parameter"),
        number_column("value", ".5f"),
        number_column("standard error", ".5f"),
        Column("unit"),
    )
    tables = []
    for name, arm in result.arms.items():
        rows: list[tuple[Cell, ...]] = []
        for parameter, estimate in arm.identified.items():
            factor, unit = geometry_unit(estimate.unit)
            error = estimate.standard_error
            rows.append((parameter, estimate.value * factor, None if error is None else error * factor, unit))
        tables.append(Table(f"Arm {name}: identified parameters", columns, tuple(rows)))
    return tables


def merged_sentences(result: CalibrateResult) -> list[str]:
    """Say which parameters were merged into others, and into which."""
    return [
        f"arm {name}: {parameter} is merged into {merged_words(shares)}"
        for name, arm in result.arms.items()
        for parameter, shares in arm.merged.items()
    ]


def merged_words(shares: Mapping[str, float]) -> str:
    """List the parameters that stand for a merged one, with their shares."""
    return ", ".join(f"{share:+.4g} {kept}" for kept, share in shares.items()) or "nothing (no effect)"


def tracker_sentences(result: CalibrateResult) -> list[str]:
    """State the error of each arm's last stage beside the tracker's uncertainty; notes on networks, motion, priors."""
    sentences = []
    for name, arm in result.arms.items():
        if arm.tracker_mm is None:
            sentences.append(f"arm {name}: the readings state no uncertainty to compare with")
            continue
        rms = arm.validate_[arm.best_stage].position_mm.rms
        sentences.append(
            f"arm {name}: {arm.best_stage} leaves {rms:.4f} mm rms, {rms / arm.tracker_mm:.1f} times the tracker's own"
            f" {arm.tracker_mm:.4f} mm"
        )
    more = (*network_sentences(result), *motion_sentences(result), *torque_sentences(result))
    return [*sentences, *more, *prior_sentences(result)]


def distance_mm(first: float | None, second: float | None) -> float | None:
    """Return the rms error [mm] of the distance of two points, from the rms lengths of their noise [mm].

    A distance has the noise of each point along one direction of three: sqrt((a^2 + b^2) / 3). None if either length
    is not known.
    """
    return None if not first or not second else math.sqrt((first**2 + second**2) / 3.0)


def cooperative_noise_mm(result: CalibrateResult) -> float | None:
    """Return the rms cooperative error [mm] that the stated uncertainty of the tracker alone would cause."""
    lengths = [arm.tracker_mm for arm in result.arms.values()]
    return distance_mm(lengths[0], lengths[1]) if len(lengths) == 2 else None


def _arm_title(name: str, arm: ArmCalibrationResult) -> str:
    return (
        f"Arm {name}: held-out errors [mm] ({counted(arm.rank, 'parameter')}, {counted(arm.iterations, 'iteration')})"
    )


def _stage_summaries(arm: ArmCalibrationResult) -> list[tuple[str, str, ErrorSummary]]:
    """Return the label, measure (position, orientation or distance) and errors of each stage."""
    found = []
    for stage in STAGES:
        if stage in arm.validate_:
            errors = arm.validate_[stage]
            found.append((f"{stage}, position", "position", errors.position_mm))
            if errors.orientation_mrad is not None:
                found.append((f"{stage}, orientation [mrad]", "orientation", errors.orientation_mrad))
            if errors.distance_mm is not None:
                found.append((f"{stage}, distance", "distance", errors.distance_mm))
    return found


def error_cells(summary: ErrorSummary) -> tuple[Cell, ...]:
    """Return the cells of ``ERROR_COLUMNS``."""
    return summary.mean, summary.rms, summary.std, summary.max, summary.n


def _detailed_cells(summary: ErrorSummary) -> tuple[Cell, ...]:
    interval = None if summary.mean_ci95 is None else Interval(*summary.mean_ci95)
    return summary.mean, interval, summary.rms, summary.std, summary.p50, summary.p95, summary.max, summary.n


def _ratio(summary: ErrorSummary, noise_mm: float | None) -> float | None:
    return None if noise_mm is None else summary.rms / noise_mm
