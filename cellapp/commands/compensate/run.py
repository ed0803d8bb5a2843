"""``compensate``: a model, its readings and targets in, commands out; the command and the library call this."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cellapp.cell.targets.compensate import Command, compensate, compensate_result
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.cell.targets.records import CompensateResult
from cellapp.cell.targets.targets import Target
from cellapp.cell.targets.unplaced_cell import UNPLACED, commanded_profile, is_unplaced
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.model import CellModel


def compensate_targets(
    profile: Profile,
    readings: Mapping[str, Readings],
    model: CellModel,
    targets: Sequence[Target],
    notes: Sequence[str] = (),
) -> tuple[tuple[Command, ...], CompensateResult]:
    """Commands for targets with a model, and their result; ``readings`` are those of the model.

    ``notes`` stand before the one that says what is not known of a cell of which nothing moves here.

    Raises
    ------
    InputError
        If the model is of other arms than the profile.
    """
    ranges = {name: ConditionRanges.of(one, model.arms.get(name)) for name, one in readings.items()}
    commands = compensate(commanded_profile(profile, readings), model, targets, ranges=ranges)
    return commands, compensate_result(commands, [*notes, *([UNPLACED] if is_unplaced(profile) else [])])
