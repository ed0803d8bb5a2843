"""Identify the arm controllers of a run: recorded when it begins, compared whenever the cell is opened."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from cellapp.cell.driving.cell import Cell
from cellapp.cell.run import RunFile
from cellapp.cell.run.arm_identity import (
    CONTROLLERS_RESULT,
    STORED_CONTROLLERS,
    ControllerIdentity,
    recorded_controllers,
)
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile import Arm as ArmProfile
from cellapp.ground.profile.device_plugins import plugins_of_devices
from cellapp.robot.kinematics.plain_dh import same_chain
from cellapp.robot.model.nominal import controller_rows, published_rows
from cellapp.robot.plugins import program_of
from drivers.arms.protocol import Arm, ArmError, stale


@dataclass(frozen=True)
class ControllerCheck:
    """Identities of the controllers of an open cell by arm, and notes about them for a person."""

    identities: Mapping[str, ControllerIdentity]
    notes: tuple[str, ...]


def check_controllers(run: RunFile, cell: Cell, *, insist: bool | None = None) -> ControllerCheck:
    """Record new controllers in the run, compare the others with their record, and log the notes.

    With ``insist``, a controller whose own D-H was changed since the run began, or is not that of the profile, is only
    noted; None if the verb has no such option.

    Raises
    ------
    HardwareError
        If an arm has another controller than the recorded one, or another calibration in it, or its controller does
        not answer. Nothing has moved.
    InputError
        If the record is damaged.
    """
    recorded = recorded_controllers(run)
    identities: dict[str, ControllerIdentity] = {}
    notes: list[str] = []
    changed: list[str] = []
    for name, arm in cell.arms.items():
        identities[name], warnings = _query(arm)
        notes += warnings
        if name in recorded:
            changed += _compare(name, recorded[name], identities[name])
        changed += _not_the_profiles(name, run.profile.arms[name], identities[name])
    if changed and not insist:
        way = "" if insist is None else ". Insist with --out-of-date to use the model all the same"
        raise HardwareError(f"{'; '.join(changed)}; nothing was moved{way}")
    notes += changed
    if set(identities) - set(recorded):
        run.write_result(
            CONTROLLERS_RESULT, STORED_CONTROLLERS.dump_json(identities | recorded, exclude_none=True).decode("utf-8")
        )
    for note in notes:
        run.log("warning", note)
    if plugins_of_devices(run.profile):
        run.log("info", f"devices opened by {program_of(run.profile)}")
    return ControllerCheck(identities, tuple(notes))


def noting_controllers(run: RunFile, notes: list[str], *, insist: bool | None = None) -> Callable[[Cell], None]:
    """Return a callback for the opened cell, to be called before anything moves.

    It checks the controllers and adds the notes to ``notes``; it raises as ``check_controllers``.
    """

    def opened(cell: Cell) -> None:
        notes.extend(check_controllers(run, cell, insist=insist).notes)

    return opened


def _query(arm: Arm) -> tuple[ControllerIdentity, tuple[str, ...]]:
    try:
        found = arm.identify()
        warnings = arm.warnings()
    except ArmError as error:
        raise HardwareError(str(error)) from error
    rows = None
    if found.dh_rows is not None and found.dh_checksum:
        rows = tuple((theta, d, a, alpha) for theta, d, a, alpha in found.dh_rows.tolist())
    return ControllerIdentity(found.model, found.serial, found.software, found.dh_checksum, rows), warnings


def _compare(name: str, before: ControllerIdentity, now: ControllerIdentity) -> list[str]:
    if before.serial and now.serial and before.serial != now.serial:
        raise HardwareError(
            f"arm {name}: the run began with controller {before.serial}, this one is {now.serial}; nothing was moved."
            " Start a new run for another arm"
        )
    if before.dh_checksum != now.dh_checksum:
        return [f"arm {name}: {stale(before.dh_checksum, now.dh_checksum)}"]
    return []


def _not_the_profiles(name: str, arm: ArmProfile, now: ControllerIdentity) -> list[str]:
    """Return a message if the controller's calibration is not the one that is nominal in the profile; else empty."""
    if arm.factory is None or same_calibration(arm, now):
        return []
    has = f"another calibration ({now.dh_checksum})" if now.dh_checksum else "no calibration of its own"
    return [
        f"arm {name}: its controller has {has} than that of arms.{name}.factory"
        f" ({arm.factory.checksum or 'without a checksum'}); write it with 'cellapp doctor PROFILE --controllers DIR',"
        " then collect and calibrate again"
    ]


def same_calibration(arm: ArmProfile, controller: ControllerIdentity) -> bool:
    """Return whether a controller computes with the rows that are nominal in the profile."""
    wanted, published = controller_rows(arm), published_rows(arm)
    has = published if controller.dh_rows is None else np.array(controller.dh_rows)
    return same_chain(wanted, has, published)
