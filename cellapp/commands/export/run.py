"""The verb ``export``: readings as CSV, calibrated arms and commands in the formats of other programs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cellapp.cell.exports.arm_export import (
    ArmExport,
    ArmFile,
    CommandFile,
    ExportResult,
    conversion_mm,
    lost_by,
    lost_parts,
    workspace,
)
from cellapp.cell.exports.export_format import (
    ArmCommands,
    CellFormat,
    CommandFormat,
    ExportFormat,
    exported_commands,
    final_commands,
    first_rates,
)
from cellapp.cell.exports.formats import (
    AnyFormat,
    all_formats,
    check_out,
    export_lines,
    files_of_arms,
    form_line,
    format_named,
    lost_sentences,
)
from cellapp.cell.run import RunFile, write_readings_csv
from cellapp.cell.run.columns import Kind
from cellapp.cell.run.csv_export import write_recordings_csv
from cellapp.cell.run.recordings import known_readings
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.targets.goals import commanded_profile, is_unplaced
from cellapp.cell.targets.records import CompensateResult, TargetCommand, VerifyResult
from cellapp.commands.export.request import ExportRequest
from cellapp.commands.plan.run import export_plan
from cellapp.commands.record import Request, View, Work
from cellapp.commands.stages import RunStages, StoredStage, read_stages
from cellapp.commands.stored_model import model_of, notes_on, require_own_factory, stage_in_force
from cellapp.estimation.calibration.quantities import conditions_of_arms
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs, require_suffix, write_new
from cellapp.ground.results import CALIBRATE, COMPENSATE, DISCOVER, VERIFY, StageName
from cellapp.ground.shell import shell_word
from cellapp.robot.kinematics.transforms import Array, xyz_of


def export_commands(
    run: RunFile, stages: RunStages, form: CommandFormat, out: Path, request: ExportRequest, outputs: Outputs
) -> ExportResult:
    """Write the commands of every arm that has some, one file each; see ``export_as_run``.

    Raises
    ------
    InputError
        If nothing was compensated or verified, that is out of date, the arm has no commands, or none that the format
        allows.
    """
    stage = _commands_stage(run, stages, request.stage or COMPENSATE)
    if form.drives and is_unplaced(run.profile):
        raise InputError(
            f"export: '{form.name}' is a program that moves an arm, and the profile does not say where arms and tracker"
            " stand, so that no motion can be checked; write the table 'commands'. Nothing was written"
        )
    records = _records(run, stages, stage)
    names = [name for name in run.profile.arms if any(record.arm == name for record in records)]
    if request.arm is not None and request.arm not in names:
        there = f"arms with commands are {', '.join(names)}" if names else "no arm has any"
        raise InputError(f"export: arm '{request.arm}' has no commands of '{stage.name}'; {there}; nothing was written")
    chosen = [request.arm] if request.arm is not None else names
    files = files_of_arms(out, chosen)
    in_force = stage_in_force(run, stages)
    source = f"run '{run.folder.resolve().name}', '{stage.name}' of {stage.written}, model of '{in_force.name}'"
    profile = commanded_profile(run.profile, {name: known_readings(run, name) for name in run.profile.arms})
    model, homes, commands = model_of(run, in_force), home_positions(profile), dict[str, ArmCommands]()
    cell = cell_bodies(profile, model)
    for name in chosen:
        own = [record for record in records if record.arm == name]
        arm, ways = profile.arms[name], exported_commands(own, name, model, cell, homes)
        commands[name] = ArmCommands(name, arm, source, homes[name], *first_rates(run.profile, arm), ways)
    texts = {files[name]: form.text(of_arm, sentences(form, run, of_arm)) for name, of_arm in commands.items()}
    write_new(texts, outputs)
    return ExportResult(
        format=form.name,
        commands={
            name: CommandFile(
                file=str(files[name]), commands=form.held(of_arm), refused=len(of_arm.commands) - form.held(of_arm)
            )
            for name, of_arm in commands.items()
        },
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _commands_stage(run: RunFile, stages: RunStages, name: str) -> StoredStage:
    """Return the stage whose commands are written; refuse one that no longer holds."""
    folder = shell_word(run.folder)
    made_by: dict[StageName, str] = {
        COMPENSATE: f"cellapp compensate {folder} TARGETS",
        VERIFY: f"cellapp push {folder} TARGETS --verify",
    }
    known = next((stage for stage in made_by if stage == name), None)
    if known is None:
        raise InputError(f"export: commands are those of the stage {COMPENSATE} or {VERIFY}, not '{name}'")
    if (stage := stages.current.get(known)) is None:
        why, again = f"{run.path} has no commands of '{name}'", "first"
    elif known in stages.out_of_date:
        why, again = f"'{name}' is out of date ({stages.out_of_date[known]})", "again"
    else:
        return stage
    raise InputError(f"export: {why}; nothing was written. Run '{made_by[known]}' {again}")


def _records(run: RunFile, stages: RunStages, stage: StoredStage) -> tuple[TargetCommand, ...]:
    computed = CompensateResult.from_json(
        _commands_stage(run, stages, COMPENSATE).text, f"{run.path}: {COMPENSATE}"
    ).targets
    if stage.name == COMPENSATE:
        return computed
    return final_commands(VerifyResult.from_json(stage.text, f"{run.path}: {VERIFY}").targets, computed)


def run(request: ExportRequest, work: Work) -> ExportResult:
    """Write the requested files."""
    with RunFile.open(request.folder) as opened:
        return export(opened, request, work.outputs)


def export(run: RunFile, request: ExportRequest, outputs: Outputs = NEW_ONLY) -> ExportResult:
    """Write tables, or the calibrated arms, the cell or the commands at targets in one format."""
    if request.form is None or request.out is None:  # the request has both or neither
        return _export_tables(run, request, outputs)
    require_own_factory(run, "export")
    form, stages, out = format_named(request.form), read_stages(run), request.out
    others = {".json", *(one.suffix for one in all_formats().values())} - {form.suffix}
    if out.suffix.lower() in others:
        require_suffix(out, (form.suffix,), f"export: '{form.name}'")
    if isinstance(form, CommandFormat):
        return export_commands(run, stages, form, out, request, outputs)
    if isinstance(form, CellFormat):
        return _export_cell(run, stages, form, out, request, outputs)
    return _export_arms(run, stages, form, out, request, outputs)


def _export_arms(
    run: RunFile, stages: RunStages, form: ExportFormat, out: Path, request: ExportRequest, outputs: Outputs
) -> ExportResult:
    exports = calibrated_arms(run, stages, request.stage)
    if request.arm is not None and request.arm not in exports:
        raise InputError(f"export: {run.path} has no calibrated arm '{request.arm}'; arms are {', '.join(exports)}")
    chosen = {name: export for name, export in exports.items() if request.arm in (None, name)}
    files = files_of_arms(out, list(chosen))
    texts = {files[name]: form.text(export, sentences(form, run, export)) for name, export in chosen.items()}
    notes = (*notes_on(stages.stale_arms()), *_rigid_notes(run, stages, chosen))
    write_new(texts, outputs)
    return ExportResult(
        format=form.name,
        arms={
            name: _arm_file(export, files[name], form.smr(export), conversion_mm(export, form.held(export.geometry)))
            for name, export in chosen.items()
        },
        notes=notes,
    )


def _export_cell(
    run: RunFile, stages: RunStages, form: CellFormat, out: Path, request: ExportRequest, outputs: Outputs
) -> ExportResult:
    if request.arm is not None:
        raise InputError(f"export: --as {form.name} writes all arms in one file; leave --arm out, or take --as urdf")
    check_out(out)
    exports = calibrated_arms(run, stages, request.stage)
    notes = (*notes_on(stages.stale_model()), *_rigid_notes(run, stages, exports))
    write_new({out: form.text(exports, sentences(form, run, *exports.values()))}, outputs)
    return ExportResult(
        format=form.name,
        arms={name: _arm_file(export, out, export.geometry.tool, 0.0) for name, export in exports.items()},
        notes=notes,
    )


def calibrated_arms(run: RunFile, stages: RunStages, stage_name: str | None = None) -> dict[str, ArmExport]:
    """Return every arm with the geometry of one stage and what that loses against the model in force."""
    in_force = stage_in_force(run, stages)
    stage = in_force if stage_name is None else _stage(run, stages, stage_name)
    model, best = model_of(run, stage), model_of(run, in_force)
    written = model.provenance.get("written", "an unknown time")
    source = f"run '{run.folder.resolve().name}', model of '{stage.name}' written {written}"
    readings = {name: known_readings(run, name) for name in best.arms}
    conditions, exports = conditions_of_arms(best.arms, readings), {}
    for name, full in best.arms.items():
        own, space = model.arms[name], workspace(readings[name].q, conditions[name], run.profile.seed)
        lost = lost_parts(full, space)
        together = lost_by(own.geometry, full, space) if lost or stage is not in_force else None
        parts = lost if stage is in_force else {}
        exports[name] = ArmExport(name, run.profile.arms[name], own, source, space[0], parts, together)
    return exports


def _stage(run: RunFile, stages: RunStages, name: str) -> StoredStage:
    found = stages.current.get(CALIBRATE if name == CALIBRATE else DISCOVER)
    if found is None or name not in (CALIBRATE, DISCOVER):
        there = [stage for stage in (CALIBRATE, DISCOVER) if stage in stages.current]
        raise InputError(f"export: {run.path} has no model of a stage '{name}'; there are {', '.join(there)}")
    return found


def _rigid_notes(run: RunFile, stages: RunStages, exports: Mapping[str, ArmExport]) -> list[str]:
    """Say for which arms the geometry identified without effects is closer to the whole model than the one written.

    Without effects in the model, the geometry absorbs what it can of them: a better chain for programs without effects.
    """
    if CALIBRATE not in stages.current or stages.current[CALIBRATE] is stages.in_force:
        return []
    rigid, notes = calibrated_arms(run, stages, CALIBRATE), []
    for name, export in exports.items():
        loss, own = rigid[name].lost_together, export.lost_together
        if loss is not None and own is not None and loss.rms_mm < own.rms_mm:
            notes.append(
                f"arm {name}: the geometry that 'calibrate' identified without effects is off by only"
                f" {loss.words}: --stage calibrate writes it"
            )
    return notes


def sentences(form: AnyFormat, run: RunFile, *arms: ArmExport | ArmCommands) -> list[str]:
    """Return the head of every file: the arms, their source, and what the file does not represent of a model."""
    lines = [form_line(form, simulated=run.profile.is_simulated)]
    for arm in arms:
        lines.append(f"Arm '{arm.name}' ({arm.arm.type.model}), {arm.source}.")
        if isinstance(arm, ArmExport):
            lines += lost_sentences(arm.lost, arm.lost_together, listed=form.lists_effects)
    return [" ".join(line.splitlines()) for line in lines]  # a line break in a name would end the comment


def _arm_file(export: ArmExport, file: Path, smr: Array, off_mm: float) -> ArmFile:
    return ArmFile.like(export, file=str(file), smr_m=xyz_of(smr), conversion_mm=off_mm)


def _export_tables(run: RunFile, request: ExportRequest, outputs: Outputs) -> ExportResult:
    """Write readings, recordings of motion or the plan as CSV, or several of these."""
    streams: dict[Kind, Path | None] = {"joints": request.joints, "points": request.points}
    recordings = {kind: path for kind, path in streams.items() if path is not None}
    if request.csv is None and request.plan is None and not recordings:
        raise InputError(
            "export: say what to write: --csv FILE for the readings, --joints FILE and --points FILE for recordings,"
            " --plan FILE for the plan, --as FORMAT --out FILE for the arms; 'cellapp docs exports' lists the formats"
        )
    if request.plan is not None:
        export_plan(run, request.plan, outputs)
    if request.csv is not None:
        write_readings_csv(run, request.csv, outputs)
    for kind, path in recordings.items():
        write_recordings_csv(run, kind, path, outputs)
    return ExportResult(
        csv=None if request.csv is None else str(request.csv),
        readings=None if request.csv is None else {name: sum(its.values()) for name, its in run.split_counts().items()},
        recordings={kind: str(path) for kind, path in recordings.items()} or None,
        plan=None if request.plan is None else str(request.plan),
    )


def view(result: ExportResult, request: Request | None = None) -> View:
    """Show the written files, and what they do not represent."""
    return View(tuple(export_lines(result)))
