"""The verb ``compensate``: compute commands for targets with the model in force."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.cell.run.samples import known_readings
from cellapp.cell.targets.compensate import Command, compensate, compensate_result
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.cell.targets.records import CompensateResult
from cellapp.cell.targets.targets import Target, load_targets
from cellapp.cell.targets.unplaced_cell import UNPLACED, commanded_profile, is_unplaced
from cellapp.commands.compensate.request import CompensateRequest
from cellapp.commands.record import Work
from cellapp.commands.stages import RunStages, append_stage, basis_on_model, read_stages
from cellapp.commands.stored_model import model_of, stage_in_force, stale_notes
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.ground.results import COMPENSATE
from cellapp.robot.model import CellModel


def run(request: CompensateRequest, work: Work) -> CompensateResult:
    """Compute and store the commands."""
    with RunFile.open(request.folder, write=True) as opened:
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
    return commands, compensate_result(commands, [*notes, *([UNPLACED] if is_unplaced(profile) else [])])
