"""State of a run's collection, as a typed result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from cellapp.cell.driving.live_model import LiveModel
from cellapp.cell.run import Outcome, RunFile
from cellapp.cell.run.measured_again import earlier_readings, missing_readings, missing_share, reference_drifts
from cellapp.commands.collect.result import CollectedStop, CollectionResult, ReplacedReading, ResidualRange
from cellapp.commands.run_results import RunResults
from cellapp.estimation.calibration.online import Residuals
from cellapp.estimation.calibration.records import ArmCalibrationResult
from cellapp.estimation.readings import Readings


def collection_state(run: RunFile, results: RunResults | None = None) -> CollectionResult | None:
    """Return sessions, missing readings, reference drift, standard errors, stops; None if no session was recorded.

    ``results`` of the run give the residuals of the stops after calibration.
    """
    sessions = run.sessions()
    if not sessions:
        return None
    missing = missing_readings(run)
    settings = run.profile.collection
    plan = run.read_plan()
    stored = {name: _stop_by_stop(run.rows(name)) for name in plan}
    model = LiveModel(run.profile, plan, stored, lambda level, text: None)
    residuals, calibrated = model.residuals(), _calibrated(results)
    numbers = {name: its.configuration.tolist() for name, its in stored.items()}
    replaced = tuple(_replaced(run, model))
    return CollectionResult(
        run=str(run.folder),
        sessions=tuple(sessions),
        missing=missing,
        missing_share=missing_share(run, missing),
        tolerated_share=settings.tolerated,
        references=reference_drifts(run),
        drift_limit_mm=settings.reference.drift * 1e3,
        standard_error_mm=model.standard_error_mm,
        stops=tuple(
            sorted(
                (*_stops(run, numbers, residuals, calibrated, replaced), *_unmeasured(missing)),
                key=lambda one: (one.stop, list(numbers).index(one.arm)),
            )
        ),
        residual_ranges={
            name: ResidualRange(before_mm=_usual_mm(residuals.get(name)), after_mm=_held_out_mm(calibrated.get(name)))
            for name, stops in numbers.items()
            if stops
        },
        replaced=replaced,
    )


def _stop_by_stop(rows: Readings) -> Readings:
    """Return the first row of each stop: earlier versions stored a row for each of several SMRs."""
    return rows.take(np.unique(rows.configuration, return_index=True)[1])


def _calibrated(results: RunResults | None) -> Mapping[str, ArmCalibrationResult]:
    """Return the calibration of each arm, while it holds."""
    calibrate = None if results is None else results.held.calibrate
    return {} if calibrate is None else calibrate.arms


def _stops(
    run: RunFile,
    numbers: Mapping[str, Sequence[int]],
    residuals: Mapping[str, Residuals],
    calibrated: Mapping[str, ArmCalibrationResult],
    replaced: Sequence[ReplacedReading],
) -> Iterator[CollectedStop]:
    """Yield the measured stops of each arm."""
    earlier = Counter((one.stop, one.arm) for one in replaced)
    late = run.late()
    for name, stops in numbers.items():
        its, none = residuals.get(name), [None] * len(stops)
        lengths, sigmas = (none, none) if its is None else ((its.length_m * 1e3).tolist(), (its.sigma_m * 1e3).tolist())
        gross = set() if its is None else set(np.array(stops)[its.gross].tolist())
        left_out = set(calibrated[name].left_out_configurations) if name in calibrated else set()
        for stop, length, sigma in zip(stops, lengths, sigmas, strict=True):
            yield CollectedStop(
                stop=stop,
                arm=name,
                residual_mm=length,
                sigma_mm=sigma,
                retried=(stop, name) in late,
                again=earlier[stop, name],
                suspicion="left out by calibrate" if stop in left_out else "gross error" if stop in gross else "",
            )


def _replaced(run: RunFile, model: LiveModel) -> Iterator[ReplacedReading]:
    """Yield the replaced readings of each arm, with their residuals from the model of the readings that count."""
    for name in run.profile.arms:
        earlier, replaced = earlier_readings(run, name)
        lengths_m = model.lengths_m(name, earlier)
        for stop, when, length_m in zip(earlier.configuration.tolist(), replaced, lengths_m, strict=True):
            residual_mm = None if length_m is None else length_m * 1e3
            yield ReplacedReading(stop=stop, arm=name, replaced=when, residual_mm=residual_mm)


def _unmeasured(missing: Sequence[Outcome]) -> Iterator[CollectedStop]:
    """Yield stops without a reading although they were tried or left out on purpose."""
    for one in missing:
        if one.kind != "not tried":
            yield CollectedStop(stop=one.stop, arm=one.arm, suspicion=f"{one.kind}: {one.reason}")


def _usual_mm(its: Residuals | None) -> float | None:
    """Return the 95th percentile [mm] of the lengths of the residuals without gross errors."""
    return None if its is None or its.gross.all() else float(np.percentile(its.length_m[~its.gross], 95)) * 1e3


def _held_out_mm(arm: ArmCalibrationResult | None) -> float | None:
    """Return the 95th percentile [mm] of the held-out errors of the calibration's last stage."""
    return None if arm is None or not arm.validate_ else arm.validate_[arm.best_stage].position_mm.p95
