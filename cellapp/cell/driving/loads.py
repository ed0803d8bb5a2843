"""Loads of a plan: which one hangs, who hangs the next, and whether the controllers know it.

An arm carries another load from one stop to the next where the plan says so. The arms go home, the cell is closed, a
person hangs the load and sets the payload of the controller; then the cell is opened anew, and every driver checks it.
A simulated cell hangs its loads itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.cell_checks import known_payload
from cellapp.cell.run import RunFile
from cellapp.ground.control import Stopped
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import SAME_PAYLOAD_KG, Profile

Hung = Callable[[str], bool]
"""Tells a person what to hang and returns whether it hangs; False where nobody is there."""

_HUNG = "hung_load"
"""Name of the document with the number of the load that hangs; it is part of the file format."""


def hung_load(run: RunFile) -> int:
    """The load that was hung last, from 0; 0 in a run whose load was never changed."""
    text = run.read_result(_HUNG)
    try:
        return 0 if text is None else int(text)
    except ValueError:
        raise InputError(f"{run.path}: the document '{_HUNG}' is damaged; restore the run from a copy") from None


def change_load(run: RunFile, load: int, stated: Mapping[str, float] | None, hung: Hung | None) -> Profile:
    """Have a load hung, with the cell closed; the run keeps that it hangs. A simulated cell needs nobody.

    ``stated`` is what a person says that arms carry [kg]; without it ``hung`` is asked. Returned is the cell with it.

    Raises
    ------
    InputError
        If the stated load is not the one that is due.
    Stopped
        If nobody hangs it.
    """
    profile, hangs = run.profile, hung_load(run)
    before, due = profile.with_load(hangs), profile.with_load(load)
    changes = {name: arm.payload for name, arm in due.arms.items() if arm.payload != before.arms[name].payload}
    if stated is not None:
        _check_stated(due, stated, changes)
    elif changes and profile.cell_kind != "simulated":
        words = "; ".join(
            f"arm {name}: hang {one.mass:g} kg, all that it carries together, and set the payload of its controller to"
            f" {one.mass:g} kg at ({', '.join(f'{x * 1e3:g}' for x in one.center_of_mass)}) mm in the flange frame"
            for name, one in changes.items()
        )
        if hung is None or not hung(f"The next stops need another load. {words}."):
            answer = ",".join(f"{name}={one.mass:g}" for name, one in changes.items())
            raise Stopped(
                f"the next stops need another load: {words}; then 'cellapp collect {run.folder} --resume --payload"
                f" {answer}'"
            )
    if changes:
        carried = ", ".join(f"{name} {arm.payload.mass:g} kg" for name, arm in due.arms.items())
        run.log("info", f"loads: {carried}")
    if load != hangs:
        run.write_result(_HUNG, str(load))
    return due


def require_load(cell: Cell, profile: Profile) -> None:
    """See that every arm of an open cell carries the load of the profile and knows it; a simulated cell hangs it.

    Raises ``HardwareError`` if a controller reports another payload, or does not answer. Nothing has moved.
    """
    for name, arm in profile.arms.items():
        if cell.person is not None:
            cell.person.hang(name, arm.payload.mass, np.array(arm.payload.center_of_mass))
        if doubt := known_payload(cell.arms[name], arm.payload.mass):
            raise HardwareError(
                f"arm {name}: not moved with {arm.payload.mass:g} kg: {doubt}; set it, then continue with --resume"
            )


def carrying(profile: Profile, loads_kg: Iterable[tuple[str, float | None]]) -> Profile:
    """The cell with the loads that commands are for, each an arm and its payload [kg], None where it does not matter.

    An arm carries another one than ``payload`` if all its commands are for the same one and the profile lists it: its
    driver then expects that on the controller, and a simulated cell hangs it. Otherwise nothing changes.
    """
    asked: dict[str, set[float]] = {}
    for name, load_kg in loads_kg:
        if load_kg is not None:
            asked.setdefault(name, set()).add(load_kg)
    arms = dict(profile.arms)
    for name, own in asked.items():
        listed = arms[name].listed_load(min(own)) if len(own) == 1 else None
        if listed is not None and listed != arms[name].payload:
            arms[name] = arms[name].model_copy(update={"payload": listed})
    return profile.model_copy(update={"arms": arms})


def require_known_loads(cell: Cell, loads_kg: Iterable[tuple[str, float]]) -> None:
    """Raise ``HardwareError`` unless the controllers of an open cell are set to what commands are for [kg]."""
    for name, load_kg in loads_kg:
        if doubt := known_payload(cell.arms[name], load_kg):
            raise HardwareError(f"arm {name}: not moved for {load_kg:g} kg: {doubt}; nothing was moved")


def other_loads(planned: Profile, profile: Profile) -> dict[str, str]:
    """References of the arms that carry another load than the plan's first one, and which, in words."""
    loads = {name: arm.payload for name, arm in profile.arms.items() if arm.payload != planned.arms[name].payload}
    return {f"arm {name}": f" with {load.mass:g} kg" for name, load in loads.items()}


def _check_stated(due: Profile, stated: Mapping[str, float], changes: Mapping[str, object]) -> None:
    for name in stated:
        if name not in due.arms:
            raise InputError(f"--payload: no arm '{name}'; arms are {', '.join(due.arms)}")
    wrong = {name: kg for name, kg in stated.items() if abs(kg - due.arms[name].payload.mass) > SAME_PAYLOAD_KG}
    if missing := [name for name in changes if name not in stated]:
        raise InputError(f"--payload: arm {missing[0]} gets another load too; say what it carries")
    if wrong:
        name, kg = next(iter(wrong.items()))
        raise InputError(
            f"--payload: arm {name} is said to carry {kg:g} kg, the next stops need {due.arms[name].payload.mass:g} kg;"
            " nothing was moved. Hang what the plan asks for, or plan anew"
        )
