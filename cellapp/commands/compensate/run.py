"""The verb ``compensate``: compute commands for targets, along paths or of a program, with the model in force."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cellapp.cell.exports.command_table import path_csv, path_script
from cellapp.cell.exports.formats import files_of_arms
from cellapp.cell.programs.records import CorrectResult
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import known_readings
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.goals import UNPLACED, commanded_profile, is_unplaced
from cellapp.cell.targets.path import PathPlan, PathResult, PathSpec, holds_paths, load_paths, path_record, plan_path
from cellapp.cell.targets.prediction import Command
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.cell.targets.records import CompensateResult
from cellapp.cell.targets.targets import Target, load_targets
from cellapp.commands.compensate.earlier_commands import refuse_corrected_targets
from cellapp.commands.compensate.program import correct
from cellapp.commands.compensate.request import CompensateRequest
from cellapp.commands.record import Work
from cellapp.commands.stages import RunStages, StoredStage, append_stage, basis_on_model, read_stages
from cellapp.commands.stored_model import model_of, stage_in_force, stale_notes
from cellapp.estimation.readings import Readings
from cellapp.estimation.uncertainty.common import divided
from cellapp.estimation.uncertainty.records import CommonUncertainty
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs, require_suffix, write_new
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.ground.results import COMPENSATE, PATH
from cellapp.ground.shell import shell_word
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.model import ArmModel, CellModel

_PERIOD_S = 0.008
"""Time between two joint positions along a path [s]: a period of the slower UR controllers, four of the others."""


def run(request: CompensateRequest, work: Work) -> CompensateResult | PathResult | CorrectResult:
    """Compute and store the commands; of a path file also write them; of a program write the corrected copy alone."""
    if request.program is not None:
        with RunFile.open(request.folder) as opened:
            return correct(opened, request, work.outputs)
    with RunFile.open(request.folder, write=True) as opened:
        if isinstance(request.targets, Path) and holds_paths(request.targets):
            paths = load_paths(request.targets, opened.profile)
            return compensate_paths(opened, paths, work.control, request.out, work.outputs)
        if request.out is not None:
            raise InputError(
                f"compensate: --out is for path files; 'cellapp export {shell_word(request.folder)} --as"
                " commands --out FILE'"
                " writes commands at targets"
            )
        return compensate_run(opened, listed_targets(request.targets, opened.profile))


def listed_targets(targets: Path | tuple[Target, ...], profile: Profile) -> tuple[Target, ...]:
    """Return the targets of a request: read from its file, or as a program gave them."""
    return load_targets(targets, profile) if isinstance(targets, Path) else targets


def compensate_run(run: RunFile, targets: Sequence[Target]) -> CompensateResult:
    """Compute and store commands for targets with the model in force; a note says if that is out of date."""
    return compensated_commands(run, read_stages(run), targets)[1]


def compensated_commands(
    run: RunFile, stages: RunStages, targets: Sequence[Target]
) -> tuple[tuple[Command, ...], CompensateResult]:
    """Compensate as ``compensate_run`` does; also return the commands themselves."""
    used = stage_in_force(run, stages)
    model = model_of(run, used)
    readings = {name: known_readings(run, name) for name in run.profile.arms}
    refuse_corrected_targets(run, model, targets)
    commands, result = compensate_targets(run.profile, readings, model, targets, stale_notes(stages, used))
    append_stage(run, COMPENSATE, result, basis_on_model(run, used, targets))
    for note in result.notes:
        run.log("warning", note)
    return commands, result


def compensate_targets(
    profile: Profile,
    readings: Mapping[str, Readings],
    model: CellModel,
    targets: Sequence[Target],
    notes: Sequence[str] = (),
) -> tuple[tuple[Command, ...], CompensateResult]:
    """Compute commands for targets with a model; ``readings`` are those of the model.

    The result has ``notes`` first, then notes on what is unknown of a cell that this program does not drive.

    Raises
    ------
    InputError
        If model and profile have different arms.
    """
    ranges = {name: ConditionRanges.of(one, model.arms.get(name)) for name, one in readings.items()}
    commands = compensate(commanded_profile(profile, readings), model, targets, ranges=ranges)
    unknown = [UNPLACED] if is_unplaced(profile) else []
    if unknown:
        commands = tuple(one.recording(visible=None) for one in commands)
    common = {name: _common(arm, name, commands, readings[name]) for name, arm in model.arms.items()}
    return commands, CompensateResult(
        targets=tuple(one.record for one in commands),
        notes=(*notes, *unknown),
        common={name: its for name, its in common.items() if its},
    )


def _common(arm: ArmModel, name: str, commands: Sequence[Command], readings: Readings) -> CommonUncertainty | None:
    """Return what the uncertainties of an arm's targets have in common; None without targets or uncertainties."""
    own = [one.record for one in commands if one.record.arm == name and one.record.q_compensated is not None]
    if not own:
        return None
    q = np.array([one.q_compensated for one in own])
    payload = np.array([one.payload_kg for one in own], dtype=np.float64)
    parts = divided(arm, q, arm.geometry.tool, MeasurementConditions(payload_kg=payload), readings.q)
    return None if parts is None else parts.common


def compensate_paths(
    run: RunFile,
    paths: Sequence[PathSpec],
    job: JobToken = UNATTENDED,
    out: Path | None = None,
    outputs: Outputs = NEW_ONLY,
) -> PathResult:
    """Plan paths with the model in force, write their joint positions to ``out``, and store the result.

    ``out`` ends with .csv, or with .script for URScript; then several arms get one file each.

    Raises
    ------
    InputError
        If the run is not calibrated, or ``out`` cannot be written.
    Cancelled
    """
    if out is not None:
        require_suffix(out, (".csv", ".script"), "compensate: a path")
    stages, plans = read_stages(run), list[PathPlan]()
    used = stage_in_force(run, stages)
    model = model_of(run, used)
    for done, spec in enumerate(paths):
        job.check()
        job.tell("paths", done, len(paths), spec.name)
        plans.append(plan_path(run.profile, model, spec, _PERIOD_S))
    job.tell("paths", len(paths), len(paths), "done")
    texts = {} if out is None else _path_texts(run, used, plans, out)
    write_new(texts, outputs)
    result = PathResult(
        paths=tuple(path_record(model, plan) for plan in plans),
        notes=tuple(stale_notes(stages, used)),
        files=tuple(map(str, texts)),
    )
    append_stage(run, PATH, result, basis_on_model(run, used, paths))
    return result


def _path_texts(run: RunFile, used: StoredStage, plans: Sequence[PathPlan], out: Path) -> dict[Path, str]:
    """Return each file to write with its text."""
    if out.suffix == ".csv":
        return {out: path_csv(plans)}
    arms = list(dict.fromkeys(plan.spec.arm for plan in plans if not plan.refusal))
    simulated = ", of a simulated cell" if run.profile.is_simulated else ""
    head = f"Compensated joint paths as URScript, by cellapp{simulated}."
    source = f"run '{run.folder.resolve().name}', model of '{used.name}' of {used.written}"
    return {
        file: path_script(
            [plan for plan in plans if plan.spec.arm == name],
            run.profile,
            [head, f"Arm '{name}' ({run.profile.arms[name].type.model}), {source}."],
        )
        for name, file in files_of_arms(out, arms).items()
    }
