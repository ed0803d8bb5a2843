"""The arm controllers of a run: recorded when it begins, compared whenever the cell is opened."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pydantic import TypeAdapter, ValidationError

from cellapp.cell.driving.cell import Cell
from cellapp.cell.run import RunFile
from cellapp.cell.run.arm_identity import CONTROLLERS_RESULT
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile.device_plugins import plugins_of_devices
from cellapp.robot.plugins import program_of
from drivers.arms.protocol import Arm, ArmError, stale


@dataclass(frozen=True)
class ControllerIdentity:
    """Identity of one controller, as it reports it; ``dh_checksum`` distinguishes factory calibrations of its D-H."""

    model: str
    serial: str
    software: str
    dh_checksum: str


@dataclass(frozen=True)
class ControllerCheck:
    """The controllers of an open cell by arm, and what a person must know about them.

    ``changed`` are those notes that make an earlier model stale.
    """

    identities: Mapping[str, ControllerIdentity]
    notes: tuple[str, ...]
    changed: tuple[str, ...] = ()


_STORED = TypeAdapter(dict[str, ControllerIdentity])


def recorded_controllers(run: RunFile) -> dict[str, ControllerIdentity]:
    """Return the controllers that a run has recorded, by arm. Raises ``InputError`` if the record is damaged."""
    text = run.read_result(CONTROLLERS_RESULT)
    if text is None:
        return {}
    try:
        return _STORED.validate_json(text)
    except ValidationError:
        raise InputError(f"{run.path}: the record of its controllers is damaged; start a new run") from None


def check_controllers(run: RunFile, cell: Cell) -> ControllerCheck:
    """Record new controllers in the run, compare the others with their record, and log the notes.

    A changed checksum of a controller's own D-H is noted: an earlier model is stale.

    Raises
    ------
    HardwareError
        If an arm has another controller than the one recorded, or its controller does not answer.
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
    notes += changed
    if set(identities) - set(recorded):
        run.write_result(CONTROLLERS_RESULT, _STORED.dump_json(identities | recorded).decode("utf-8"))
    for note in notes:
        run.log("warning", note)
    if plugins_of_devices(run.profile):
        run.log("info", f"devices opened by {program_of(run.profile)}")
    return ControllerCheck(identities, tuple(notes), tuple(changed))


def noting_controllers(run: RunFile, notes: list[str]) -> Callable[[Cell], None]:
    """Return what is to be called with the opened cell before anything moves.

    It checks the controllers and raises as ``check_controllers`` does; what it finds is added to ``notes``.
    """

    def opened(cell: Cell) -> None:
        notes.extend(check_controllers(run, cell).notes)

    return opened


def _query(arm: Arm) -> tuple[ControllerIdentity, tuple[str, ...]]:
    try:
        found = arm.identify()
        warnings = arm.warnings()
    except ArmError as error:
        raise HardwareError(str(error)) from error
    return ControllerIdentity(found.model, found.serial, found.software, found.dh_checksum), warnings


def _compare(name: str, before: ControllerIdentity, now: ControllerIdentity) -> list[str]:
    if before.serial and now.serial and before.serial != now.serial:
        raise HardwareError(
            f"arm {name}: the run began with controller {before.serial}, this one is {now.serial}; nothing was moved."
            " Start a new run for another arm"
        )
    if before.dh_checksum != now.dh_checksum:
        return [f"arm {name}: {stale(before.dh_checksum, now.dh_checksum)}"]
    return []
