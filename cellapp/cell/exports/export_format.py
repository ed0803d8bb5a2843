"""Compensated commands of one arm, as input of every export of commands.

Declarations of formats. A new format is a module that ends with its declaration; see ``formats``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellapp.cell.exports.arm_export import ArmExport
from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.cell.targets.ranges import signs_words
from cellapp.cell.targets.records import MeasuredTarget, TargetCommand
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.kinematics.chain import Geometry, plain_geometry
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel
from cellapp.robot.model.inverse import STEP_BACK_RAD, with_approach


@dataclass(frozen=True)
class ExportedCommand:
    """Command for one target.

    Attributes
    ----------
    record : TargetCommand
        Command as computed.
    way : sequence of array (N,)
        Joint positions [rad] from home to the target, the command last; the joints arrive there from the command's
        side. Empty if it must not be driven.
    refusal : str
        Why it must not be driven; empty if it may.
    """

    record: TargetCommand
    way: tuple[Array, ...]
    refusal: str


@dataclass(frozen=True)
class ArmCommands:
    """Commands of one arm.

    ``source`` names the run and the stage that they are from; ``speed`` [rad/s] and ``acceleration`` [rad/s^2] are
    allowed for every joint.
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
    """Return the commands of one arm with ways from home that the gate has checked, with all other arms at home."""
    return tuple(ExportedCommand(record, *_way(record, name, model, cell, homes)) for record in records)


def final_commands(measured: Sequence[MeasuredTarget], computed: Sequence[TargetCommand]) -> tuple[TargetCommand, ...]:
    """Return the commands as left by verification: those sent last, with corrections if they were better.

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
        found.append(_last_driven(record, one))
    return tuple(found)


def first_rates(profile: Profile, arm: Arm) -> tuple[float, float]:
    """Return the limits of joint speed [rad/s] and acceleration [rad/s^2]: those of first motions on real hardware."""
    joints = arm.type.joints
    share = arm.speed_scale * profile.collection.slow_start.speed
    speeds, accelerations = (np.array([getattr(joint, key) for joint in joints]) for key in ("speed", "acceleration"))
    return float(speeds.min() * share), float(accelerations.min() * share)


_NO_COMMAND = {"q_nominal": None, "q_compensated": None, "approach": None, "holds_for": "", "verdict": "not decided"}
"""Fields of a target that was not driven."""

# -- inside -----------------------------------------------------------------------------------------------------------


def _last_driven(record: TargetCommand, one: MeasuredTarget) -> TargetCommand:
    """Return the command that was sent last and measured; it is valid for the sides from which the joints then arrived.

    A target that was not driven has none. Results of earlier versions do not state what was sent.
    """
    if record.refusal:
        return record
    sent = one.q_corrected or one.q_driven
    if sent is None and one.q is None:
        return record.model_copy(update={"refusal": f"not driven: {one.note or 'no reason is stored'}", **_NO_COMMAND})
    if sent is None:
        return record
    unknown = tuple(condition for condition in record.unknown if condition.condition != "approach")
    words = ["as driven by push", *record.holds_for.split("; ")[1:]]
    if one.approach is not None:
        words.insert(0, f"joints that arrive with the signs {signs_words(one.approach)}")
    kept = {"q_compensated": sent, "approach": one.approach, "unknown": unknown, "holds_for": "; ".join(words)}
    return record.model_copy(update=kept)


def _way(
    record: TargetCommand, name: str, model: CellModel, cell: CellBodies, homes: Mapping[str, Array]
) -> tuple[tuple[Array, ...], str]:
    """Return the way from home to a target, and why it must not be driven (empty if it may).

    The joints arrive from the command's side: straight from home if that is this side, else after a step back.
    """
    if record.refusal or record.q_compensated is None:
        return (), record.refusal or "it has no command"
    if record.partner:
        return (), f"cooperative: arm '{record.partner}' must be there too; push drives both"
    q = np.array(record.q_compensated)
    signs = np.zeros(len(q)) if record.approach is None else np.array(record.approach, dtype=np.float64)
    chosen = any(one.condition == "approach" for one in record.unknown)
    arrives = bool(np.all((signs == 0.0) | (signs == np.sign(q - homes[name]))))
    if chosen and not record.holds_for:  # of an earlier version, for the middle of the backlash
        way: tuple[Array, ...] = (with_approach(model.arms[name], q, homes[name]),)
    elif not signs.any() or (chosen and arrives):
        way = (q,)
    else:
        way = (q - STEP_BACK_RAD * signs, q)
    here = dict(homes)
    for there in (*way, homes[name]):
        refusal = refuse_motion(cell, here, {**here, name: there})
        if refusal:
            return (), f"refused on the way from home and back: {refusal}"
        here[name] = there
    return way, ""


Text = Callable[[ArmExport, Sequence[str]], str]
"""Function that writes an arm in one format, with sentences as a comment; raises ``InputError`` if it cannot."""


def smr_in_plain_flange(export: ArmExport) -> Array:
    """Return the SMR centre (3,) [m] in the last frame of the plain D-H rows."""
    return plain_geometry(export.geometry).tool


@dataclass(frozen=True)
class Format:
    """Format of files.

    Attributes
    ----------
    name : str
        Value for ``--as``.
    what : str
        What the file is, in a few words.
    suffix : str
        Usual file name suffix.
    lists_effects : bool
        Whether the file lists the values of effects, though no chain computes them.
    """

    name: str
    what: str
    suffix: str
    lists_effects: bool = field(default=False, kw_only=True)


@dataclass(frozen=True)
class ExportFormat(Format):
    """Format of files for calibrated arms.

    Attributes
    ----------
    text : callable
        Function that returns the text of the file.
    held : callable
        Function that returns the chain represented by the file's numbers, from the identified chain.
    smr : callable
        Function that returns the SMR centre (3,) [m] in the last frame of the file.
    """

    text: Text
    held: Callable[[Geometry], Geometry] = lambda geometry: geometry
    smr: Callable[[ArmExport], Array] = lambda export: export.geometry.tool


@dataclass(frozen=True)
class CellFormat(Format):
    """Format of files for the whole calibrated cell; ``text`` takes the arms by name."""

    text: Callable[[Mapping[str, ArmExport], Sequence[str]], str]


@dataclass(frozen=True)
class CommandFormat(Format):
    """Format of files for the commands of one arm at targets; ``held`` returns the number of commands in a file.

    ``drives`` means that a controller runs the file as it is, so that its motions must have been checked.
    """

    text: Callable[[ArmCommands, Sequence[str]], str]
    held: Callable[[ArmCommands], int]
    drives: bool = False
