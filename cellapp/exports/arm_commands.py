"""The compensated commands of one arm as every export of commands gets them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.compensation.compensate import with_approach
from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.model import CellModel
from cellapp.profile import Arm
from cellapp.results import MeasuredTarget, TargetCommand
from cellapp.safety.gate import CellBodies, refuse_motion

STEP_BACK_RAD = float(np.radians(1.0))
"""How far a joint steps back to come from the side that its command is for: well beyond any play."""


@dataclass(frozen=True)
class ExportedCommand:
    """One target's command.

    Attributes
    ----------
    record : TargetCommand
        As it was computed.
    way : sequence of array (N,)
        Joint positions [rad] from home to the target, the target last, for the direction in which its joints arrive
        on that way. Empty where it must not be driven so.
    refusal : str
        Why not; empty otherwise.
    """

    record: TargetCommand
    way: tuple[Array, ...]
    refusal: str


@dataclass(frozen=True)
class ArmCommands:
    """The commands of one arm.

    ``source`` says which stage of which run they are from; ``speed`` [rad/s] and ``acceleration`` [rad/s^2] are those
    that every joint may have.
    """

    name: str
    arm: Arm
    source: str
    home: Array
    speed: float
    acceleration: float
    commands: tuple[ExportedCommand, ...]


def exported_commands(
    records: Sequence[TargetCommand], name: str, model: CellModel, cell: CellBodies, homes: Mapping[str, Array]
) -> tuple[ExportedCommand, ...]:
    """The commands of one arm with their ways from home, which the gate has checked with all other arms at home."""
    found = []
    for record in records:
        way, refusal = _way(record, name, model, cell, homes)
        found.append(ExportedCommand(record, () if refusal else way, refusal))
    return tuple(found)


def final_commands(measured: Sequence[MeasuredTarget], computed: Sequence[TargetCommand]) -> tuple[TargetCommand, ...]:
    """Commands as verification left them: corrected by measuring where that was better, else as they were computed.

    Raises
    ------
    InputError
        If a measured target has no command among ``computed``.
    """
    by_name = {(record.name, record.arm): record for record in computed}
    found = []
    for one in measured:
        record = by_name.get((one.name, one.arm))
        if record is None:
            raise InputError(
                f"export: target '{one.name}' of arm '{one.arm}' was verified, but other targets were compensated"
                " since; nothing was written. Leave --stage out, or push these targets again"
            )
        found.append(_corrected(record, one))
    return tuple(found)


# -- inside -----------------------------------------------------------------------------------------------------------


def _corrected(record: TargetCommand, one: MeasuredTarget) -> TargetCommand:
    """The command with its correction, which holds for the side from which it was measured."""
    if one.q_corrected is None:
        return record
    unknown = tuple(condition for condition in record.unknown if condition.condition != "approach")
    kept = {"q_compensated": one.q_corrected, "approach": one.approach, "unknown": unknown}
    return record.model_copy(update=kept)


def _way(
    record: TargetCommand, name: str, model: CellModel, cell: CellBodies, homes: Mapping[str, Array]
) -> tuple[tuple[Array, ...], str]:
    """Way from home to a target, and why it must not be driven (empty if it may)."""
    if record.refusal or record.q_compensated is None:
        return (), record.refusal or "it has no command"
    if record.partner:
        return (), f"cooperative: arm '{record.partner}' must be there too; 'cellapp push' drives both"
    q = np.array(record.q_compensated)
    offered = any(one.condition == "approach" for one in record.unknown)
    if record.approach is not None and any(record.approach) and not offered:
        way: tuple[Array, ...] = (q - STEP_BACK_RAD * np.array(record.approach), q)
    else:
        way = (with_approach(model.arms[name], q, homes[name]),)
    here = dict(homes)
    for there in (*way, homes[name]):
        refusal = refuse_motion(cell, here, {**here, name: there})
        if refusal:
            return (), f"refused on the way from home and back: {refusal}"
        here[name] = there
    return way, ""
