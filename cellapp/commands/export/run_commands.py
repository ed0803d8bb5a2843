"""The verb ``export`` for commands: those last computed by ``compensate`` or verified by ``push``."""

from __future__ import annotations

from pathlib import Path

from cellapp.cell.exports.arm_commands import ArmCommands, exported_commands, final_commands, first_rates
from cellapp.cell.exports.export_format import CommandFormat
from cellapp.cell.exports.formats import form_line
from cellapp.cell.exports.out_files import files_of_arms
from cellapp.cell.exports.records import CommandFile, ExportResult
from cellapp.cell.profile.files import write_new
from cellapp.cell.run import RunFile
from cellapp.cell.run.samples import known_readings
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.targets.goals import commanded_profile, is_unplaced
from cellapp.cell.targets.records import CompensateResult, TargetCommand, VerifyResult
from cellapp.commands.stages import RunStages, StoredStage
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs
from cellapp.ground.profile import Profile
from cellapp.ground.results import COMPENSATE, VERIFY


def export_commands(
    run: RunFile,
    stages: RunStages,
    form: CommandFormat,
    out: Path,
    arm: str | None = None,
    stage_name: str | None = None,
    outputs: Outputs = NEW_ONLY,
) -> ExportResult:
    """Write the commands of every arm that has some, one file each; see ``export_as_run``.

    Raises
    ------
    InputError
        If nothing was compensated or verified, that is out of date, the arm has no commands, or none that the format
        allows.
    """
    stage = _stage(run, stages, stage_name or COMPENSATE)
    if form.drives and is_unplaced(run.profile):
        raise InputError(
            f"export: '{form.name}' is a program that moves an arm, and the profile does not say where arms and tracker"
            " stand, so that no motion can be checked; write the table 'commands'. Nothing was written"
        )
    records = _records(run, stages, stage)
    names = [name for name in run.profile.arms if any(record.arm == name for record in records)]
    if arm is not None and arm not in names:
        there = f"arms with commands are {', '.join(names)}" if names else "no arm has any"
        raise InputError(f"export: arm '{arm}' has no commands of '{stage.name}'; {there}; nothing was written")
    chosen = [arm] if arm is not None else names
    files = files_of_arms(out, chosen)
    commands = {name: _of_arm(run, stages, stage, records, name) for name in chosen}
    texts = {files[name]: form.text(of_arm, _sentences(form, of_arm, run.profile)) for name, of_arm in commands.items()}
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


def _stage(run: RunFile, stages: RunStages, name: str) -> StoredStage:
    """Return the stage whose commands are written; refuse one that no longer holds."""
    if name not in (COMPENSATE, VERIFY):
        raise InputError(f"export: commands are those of the stage {COMPENSATE} or {VERIFY}, not '{name}'")
    known = COMPENSATE if name == COMPENSATE else VERIFY
    stage = stages.current.get(known)
    verb = f"cellapp compensate {run.folder} TARGETS" if known == COMPENSATE else f"cellapp push {run.folder} TARGETS"
    if stage is None:
        raise InputError(f"export: {run.path} has no commands of '{name}'; nothing was written. Run '{verb}' first")
    if known in stages.out_of_date:
        reason = stages.out_of_date[known]
        raise InputError(f"export: '{name}' is out of date ({reason}); nothing was written. Run '{verb}' again")
    return stage


def _records(run: RunFile, stages: RunStages, stage: StoredStage) -> tuple[TargetCommand, ...]:
    computed = CompensateResult.from_json(_stage(run, stages, COMPENSATE).text, f"{run.path}: {COMPENSATE}").targets
    if stage.name == COMPENSATE:
        return computed
    return final_commands(VerifyResult.from_json(stage.text, f"{run.path}: {VERIFY}").targets, computed)


def _of_arm(
    run: RunFile, stages: RunStages, stage: StoredStage, records: tuple[TargetCommand, ...], name: str
) -> ArmCommands:
    in_force = stage_in_force(run, stages)
    profile = commanded_profile(run.profile, {name: known_readings(run, name) for name in run.profile.arms})
    model, homes, arm = model_of(run, in_force), home_positions(profile), profile.arms[name]
    speed, acceleration = first_rates(run.profile, arm)
    return ArmCommands(
        name=name,
        arm=arm,
        source=f"run '{run.folder.resolve().name}', '{stage.name}' of {stage.written}, model of '{in_force.name}'",
        home=homes[name],
        speed=speed,
        acceleration=acceleration,
        commands=exported_commands(
            [record for record in records if record.arm == name], name, model, cell_bodies(profile, model), homes
        ),
    )


def _sentences(form: CommandFormat, commands: ArmCommands, profile: Profile) -> list[str]:
    lines = [
        form_line(form, simulated=profile.is_simulated),
        f"Arm '{commands.name}' ({commands.arm.type.model}), {commands.source}.",
    ]
    return [" ".join(line.splitlines()) for line in lines]  # a line break in a name would end the comment
