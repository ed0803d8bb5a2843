"""Checks before commands are sent: arms, controllers, payloads and SMR mounts must be the calibrated ones."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.controllers import check_controllers
from cellapp.cell.run import RunFile
from cellapp.cell.targets.command import Command
from cellapp.cell.targets.working_conditions import conditions_of
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import SAME_PAYLOAD_KG, Profile
from cellapp.ground.profile import Arm as ArmProfile
from cellapp.robot.model import ArmModel, CellModel
from drivers.arms.protocol import Arm, ArmError

_SAME_MOUNT = 1e-6
"""Tolerance for equal offsets [m] and unit vectors: covers rounding when they are written."""
_MOST_NAMED = 3
"""Number of findings that one sentence lists; the others are only counted."""


def require_same_arms(profile: Profile, model: CellModel, commands: Sequence[Command]) -> None:
    """Raise ``InputError`` unless profile, model and commands are of the same arms and SMR mounts."""
    if not commands:
        raise InputError("push: there are no targets; give a list with at least one")
    if set(model.arms) != set(profile.arms):
        raise InputError(
            f"push: the calibration is of arms {', '.join(model.arms)}, the profile of arms {', '.join(profile.arms)};"
            " nothing was moved. Calibrate this run again"
        )
    for command in commands:
        if command.arm not in profile.arms:
            raise InputError(
                f"push: target '{command.target.name}' is for arm '{command.arm}', the profile has arms"
                f" {', '.join(profile.arms)}; nothing was moved. Give the target list of this cell"
            )
    for name, arm in profile.arms.items():
        if problem := _other_mount(arm, model.arms[name]):
            raise InputError(
                f"push: arm {name}: {problem}; nothing was moved. After the SMR was mounted anew, measure and calibrate"
                " again; else set the profile back"
            )


def check_cell(run: RunFile, cell: Cell, commands: Sequence[Command], *, changed_controller: bool) -> tuple[str, ...]:
    """Compare the controllers of an open cell with those of the run; return notes for a person.

    ``changed_controller`` accepts a controller whose D-H checksum has changed since the run was collected.

    Raises
    ------
    HardwareError
        If an arm has another controller, its D-H checksum has changed, or its payload is not that of a target or of
        the run. Nothing has moved.
    InputError
        If the run's record of its controllers is damaged.
    """
    found = check_controllers(run, cell, insist=changed_controller)
    wrong = list(_wrong_payloads(run, cell, commands))
    if wrong:
        more = [f"{len(wrong) - _MOST_NAMED} more"] if len(wrong) > _MOST_NAMED else []
        raise HardwareError(
            f"push: {'; '.join([*wrong[:_MOST_NAMED], *more])}; nothing was moved. Set the payload of the load that the"
            " arm carries on its controller, or state it at the target (conditions.payload)"
        )
    return found.notes


# -- inside -----------------------------------------------------------------------------------------------------------


def _other_mount(arm: ArmProfile, model: ArmModel) -> str:
    """Return how the profile's SMR mount differs from that of the calibrated model; empty if it does not."""
    offset, before = arm.smr.offset, model.nominal.tool
    if offset != "unknown" and not np.allclose(offset, before, rtol=0.0, atol=_SAME_MOUNT):
        return (
            f"smr.offset is {_millimetres(offset)} in the profile, {_millimetres(before.tolist())} when the run was"
            " calibrated"
        )
    normal = np.array(arm.smr.normal) / math.hypot(*arm.smr.normal)
    if model.smr_normal is not None and not np.allclose(normal, model.smr_normal, rtol=0.0, atol=_SAME_MOUNT):
        now, then = (", ".join(f"{x:.3g}" for x in vector) for vector in (normal.tolist(), model.smr_normal.tolist()))
        return f"smr.normal is ({now}) in the profile, ({then}) when the run was calibrated"
    return ""


def _millimetres(point: Sequence[float]) -> str:
    return f"({', '.join(f'{1e3 * x:.3f}' for x in point)}) mm"


def known_payload(arm: Arm, load_kg: float) -> str:
    """Return why an arm must not be driven with a load: its controller has another payload; empty if equal or unknown.

    Raise ``HardwareError`` if the controller does not answer.
    """
    try:
        known_kg = arm.state().payload_kg
    except ArmError as error:
        raise HardwareError(str(error)) from error
    if known_kg is None or abs(known_kg - load_kg) <= SAME_PAYLOAD_KG:
        return ""
    return (
        f"the payload of its controller is set to {known_kg:.3f} kg; an arm that does not know its load is not driven"
    )


def _wrong_payloads(run: RunFile, cell: Cell, commands: Sequence[Command]) -> Iterator[str]:
    """Yield the controllers' payloads that do not fit a target or the run, as text; skip controllers without one."""
    ranges = _payload_ranges(run)
    for name in dict.fromkeys(command.arm for command in commands):
        try:
            has_kg = cell.arms[name].tool().payload_kg
        except ArmError as error:
            raise HardwareError(str(error)) from error
        if has_kg is None:
            continue
        own = [command for command in commands if command.arm == name]
        for stated_kg in dict.fromkeys(conditions_of(command.target, name).payload for command in own):
            low, high = ranges[name] if stated_kg is None else (stated_kg, stated_kg)
            several = high - low > SAME_PAYLOAD_KG
            if several:  # without a stated payload a command is for the profile's
                low = high = run.profile.arms[name].payload.mass
            if low - SAME_PAYLOAD_KG <= has_kg <= high + SAME_PAYLOAD_KG:
                continue
            first = next(
                command.target.name for command in own if conditions_of(command.target, name).payload == stated_kg
            )
            why = "the run was measured with" if stated_kg is None else f"target '{first}' states"
            if several:
                why = f"the readings had several, and target '{first}', which states none, is for"
            yield f"arm {name}: its controller is set to a payload of {has_kg:.3f} kg, {why} {low:.3f} kg"


def _payload_ranges(run: RunFile) -> Mapping[str, tuple[float, float]]:
    """Return the smallest and largest payload of each arm's readings [kg]; the profile's if they state none."""
    found = {}
    for name, arm in run.profile.arms.items():
        stated_kg = run.readings(name).payload_kg
        known_kg = np.array([]) if stated_kg is None else stated_kg[np.isfinite(stated_kg)]
        known_kg = known_kg if len(known_kg) else np.array([arm.payload.mass])
        found[name] = (float(known_kg.min()), float(known_kg.max()))
    return found
