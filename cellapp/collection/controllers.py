"""Whose readings a run holds: the controllers are recorded when it begins and compared whenever the cell is opened."""

from __future__ import annotations

import json

from cellapp.collection.cell import Cell
from cellapp.errors import HardwareError
from cellapp.run import RunFile
from drivers.arms.protocol import ArmError
from drivers.arms.ur_checks import stale

CONTROLLERS_RESULT = "controllers"
"""Name of the result: arm -> model, serial, software, dh_checksum."""


def check_controllers(run: RunFile, cell: Cell) -> tuple[str, ...]:
    """Record who the controllers are, or compare them with what was recorded. Returns and logs what a person must know.

    A changed checksum of a controller's own D-H warns: a model from before is stale.

    Raises
    ------
    HardwareError
        If an arm's controller is not the one with which the run began, or does not answer.
    """
    text = run.read_result(CONTROLLERS_RESULT)
    recorded = {} if text is None else json.loads(text)
    notes: list[str] = []
    now = {}
    for name, arm in cell.arms.items():
        try:
            identity = arm.identify()
            notes += arm.warnings()
        except ArmError as error:
            raise HardwareError(str(error)) from error
        now[name] = {
            "model": identity.model,
            "serial": identity.serial,
            "software": identity.software,
            "dh_checksum": identity.dh_checksum,
        }
        before = recorded.get(name)
        if before is None:
            continue
        if before["serial"] and identity.serial and before["serial"] != identity.serial:
            raise HardwareError(
                f"arm {name}: the run was begun with controller {before['serial']}, this one is {identity.serial};"
                " nothing was moved. Start a new run for another arm"
            )
        if before["dh_checksum"] != identity.dh_checksum:
            notes.append(f"arm {name}: {stale(before['dh_checksum'], identity.dh_checksum)}")
    if set(now) - set(recorded):
        run.write_result(CONTROLLERS_RESULT, json.dumps(now | recorded))
    for note in notes:
        run.log("warning", note)
    return tuple(notes)
