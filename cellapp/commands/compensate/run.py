"""The verb ``compensate``: commands for targets with the model in force."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.cell.run import RunFile
from cellapp.cell.targets.compensate import Command, compensate, compensate_result
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.cell.targets.records import CompensateResult
from cellapp.cell.targets.targets import Target
from cellapp.cell.targets.unplaced_cell import UNPLACED, commanded_profile, is_unplaced
from cellapp.commands.stages import RunStages, append_stage, basis_on_model, read_stages
from cellapp.commands.stored_model import model_of, stage_in_force, stale_notes
from cellapp.ground.results import COMPENSATE


def compensate_run(run: RunFile, targets: Sequence[Target]) -> CompensateResult:
    """Compute and store commands for targets with the model in force; a note says where that is out of date."""
    return compensated_commands(run, read_stages(run), targets)[1]


def compensated_commands(
    run: RunFile, stages: RunStages, targets: Sequence[Target]
) -> tuple[tuple[Command, ...], CompensateResult]:
    """As ``compensate_run``; also returns the commands themselves."""
    used = stage_in_force(run, stages)
    model = model_of(run, used)
    ranges = {name: ConditionRanges.of(run.readings(name), model.arms.get(name)) for name in run.profile.arms}
    commands = compensate(commanded_profile(run), model, targets, ranges=ranges)
    notes = [*stale_notes(stages, used), *([UNPLACED] if is_unplaced(run.profile) else [])]
    result = compensate_result(commands, notes)
    append_stage(run, COMPENSATE, result, basis_on_model(run, used, targets))
    for note in notes:
        run.log("warning", note)
    return commands, result
