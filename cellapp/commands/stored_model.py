"""Models that a run stores with its stages, and the calibration that they come from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cellapp.cell.run.file import RunFile
from cellapp.commands.stages import CALIBRATION_FILE, Basis, RunStages, StoredStage, append_stage, not_calibrated
from cellapp.estimation.calibration.records import CalibrateResult, largest_correlations, tied_estimates
from cellapp.estimation.calibration.station_location import wrong_factory
from cellapp.estimation.monitoring.parameter_changes import CalibratedArm, combinations
from cellapp.ground.errors import InputError
from cellapp.ground.results import CALIBRATE, LOCATE, Result, StageName
from cellapp.ground.shell import shell_word
from cellapp.robot.model.model import CellModel


def stage_in_force(run: RunFile, stages: RunStages) -> StoredStage:
    """Return the stage whose model compensation uses. Raises ``InputError`` if the run is not calibrated yet."""
    if stages.in_force is None:
        raise not_calibrated(run.path, run.folder)
    return stages.in_force


def model_of(run: RunFile, stage: StoredStage) -> CellModel:
    """Return the model of a stage. Raises ``InputError`` if it is missing or damaged."""
    if stage.model is None:
        raise InputError(
            f"{run.folder / CALIBRATION_FILE} is missing or damaged;"
            f" run 'cellapp calibrate {shell_word(run.folder)}' again"
        )
    return CellModel.from_json(stage.model, f"{run.path}: {stage.name}")


def values_in_force(result: CalibrateResult, model: CellModel) -> CalibrateResult:
    """Return the calibration with the values in ``model``, that of the stage in force, of the same parameters: each
    with its shares of those that are merged into it, which stay nominal."""
    arms = dict(result.arms)
    for name, arm in result.arms.items():
        own, stored = model.arms[name], arm.identified
        if own.covariance is None:
            continue
        determined = tuple(key for key, one in stored.items() if one.tied_to is None)
        calibrated = CalibratedArm(own, determined, arm.merged, arm.degrees_of_freedom, {})
        kept, _, values, covariance = combinations(calibrated, calibrated)
        related, errors = largest_correlations(kept, covariance), np.sqrt(np.maximum(np.diag(covariance), 0.0))
        nominal = dict(zip(own.nominal.names, own.nominal.vector().tolist(), strict=True))
        found = {}
        for key, value, error in zip(kept, values.tolist(), errors.tolist(), strict=True):
            held = True if key in own.geometry.at_bound else None
            new: dict[str, Any] = {"value": value, "standard_error": None if held else error, "nominal": nominal[key]}
            new |= {"correlations": {} if held else related[key], "at_bound": held}
            found[key] = stored[key].model_copy(update=new)
        arms[name] = arm.model_copy(update={"identified": found | tied_estimates(found, own.geometry.tied_to, nominal)})
    return result.model_copy(update={"arms": arms})


def arms_stage(run: RunFile, stages: RunStages) -> StoredStage:
    """Return the stage whose model is in the tracker frame of the readings, even if the tracker was located later.

    Raises ``InputError`` if the run is not calibrated yet.
    """
    used = stage_in_force(run, stages)
    return stages.current[next(iter(used.basis.stages))] if used.name == LOCATE else used


def require_current_model(run: RunFile, stages: RunStages, verb: str) -> None:
    """Raise ``InputError`` if the model in force no longer holds; ``verb`` is the intended use."""
    if stale := stages.stale_model():
        raise InputError(
            f"{verb}: {stale}; nothing was moved. Run '{stages.next_step(run.folder)}' first, or insist with"
            " --out-of-date"
        )


def require_own_factory(run: RunFile, verb: str) -> None:
    """Raise ``InputError`` if an arm's factory calibration explains the readings worse than the published table."""
    for name, arm in run.profile.arms.items():
        if misfit := wrong_factory(arm, run.readings(name)):
            raise InputError(
                f"{verb}: arm '{name}': {misfit}; nothing was written or moved. Give the calibration.conf of this arm's"
                f" controller as arms.{name}.factory, or none, then import and calibrate again"
            )


def stale_notes(stages: RunStages, used: StoredStage) -> list[str]:
    """Return a note if the model of stage ``used`` is used although it no longer holds."""
    return notes_on(stages.stale_model(), f"the model in force, that of '{used.name}',")


def notes_on(stale: str, model: str = "the model") -> list[str]:
    """Return a note that a model was used although it is ``stale``; empty if it is not."""
    return [f"{model} was used although {stale}"] if stale else []


def append_with_model(run: RunFile, name: StageName, result: Result, model: CellModel, basis: Basis) -> None:
    """Append a stage with its model, whose provenance records the stage's name and basis."""
    stored = replace(model, provenance={**model.provenance, "stage": name, "basis": basis.model_dump()})
    append_stage(run, name, result, basis, stored.to_json())


def export_model(run: RunFile, stages: RunStages) -> None:
    """Write the model in force to a file for other programs."""
    model_of(run, stage_in_force(run, stages)).save(run.folder / CALIBRATION_FILE)


def comparable_arms(run: RunFile, stages: RunStages) -> dict[str, CalibratedArm]:
    """Return the arms of the model in force that have a covariance; none if this version cannot read the model."""
    calibrated = stages.current.get(CALIBRATE)
    if calibrated is None or stages.in_force is None:
        return {}
    try:
        model = model_of(run, stages.in_force)
        stored = CalibrateResult.from_json(calibrated.text, f"{run.path}: {CALIBRATE}")
    except InputError:  # another version stored it
        return {}
    temperatures_c = run.mean_temperatures()
    return {
        name: CalibratedArm(
            arm,
            tuple(key for key, one in own.identified.items() if not one.at_bound),
            own.merged,
            own.degrees_of_freedom,
            temperatures_c.get(name, {}),
        )
        for name, arm in model.arms.items()
        if (own := stored.arms.get(name)) is not None and arm.covariance is not None
    }
