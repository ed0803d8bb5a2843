"""Loads of a plan: which one is attached, who attaches the next one, and whether the controllers are set to it.

If the plan says so, an arm carries another load from some stop on. Then the arms go home, the cell is closed, and a
person attaches the load and sets the controller's payload; the cell is opened anew, and every driver checks the
payload. A simulated cell attaches its loads itself.
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
"""Callback: tells a person what to attach; returns whether it is attached, False if nobody is there."""

_HUNG = "hung_load"
"""Name of the document with the index of the attached load; part of the file format."""


def hung_load(run: RunFile) -> int:
    """Return the index of the load that was attached last; 0 in a run whose load was never changed."""
    text = run.read_result(_HUNG)
    try:
        return 0 if text is None else int(text)
    except ValueError:
        raise InputError(f"{run.path}: the document '{_HUNG}' is damaged; restore the run from a copy") from None


def change_load(run: RunFile, load: int, stated: Mapping[str, float] | None, hung: Hung | None) -> Profile:
    """Have a load attached while the cell is closed, and record that in the run. A simulated cell needs nobody.

    ``stated`` is what the arms carry according to a person [kg]; if None, ``hung`` is called. Return the new profile.

    Raises
    ------
    InputError
        If the stated load is not the one that comes next.
    Stopped
        If nobody attaches it.
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
    """Check that every arm of an open cell carries the profile's load and is set to it; a simulated cell attaches it.

    Raise ``HardwareError`` if a controller reports another payload, or does not answer. Nothing has moved.
    """
    for name, arm in profile.arms.items():
        if cell.plant is not None:
            cell.plant.set_payload(name, arm.payload.mass, np.array(arm.payload.center_of_mass))
        if doubt := known_payload(cell.arms[name], arm.payload.mass):
            raise HardwareError(
                f"arm {name}: not moved with {arm.payload.mass:g} kg: {doubt}; set it, then continue with --resume"
            )


def carrying(profile: Profile, loads_kg: Iterable[tuple[str, float | None]]) -> Profile:
    """Return the profile with the loads that commands are for: pairs of arm and payload [kg], None if any will do.

    An arm's ``payload`` changes only if all its commands are for the same load and the profile lists that load. Its
    driver then expects it on the controller, and a simulated cell attaches it.
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
    """Raise ``HardwareError`` unless the controllers of an open cell are set to the commands' loads [kg]."""
    for name, load_kg in loads_kg:
        if doubt := known_payload(cell.arms[name], load_kg):
            raise HardwareError(f"arm {name}: not moved for {load_kg:g} kg: {doubt}; nothing was moved")


def other_loads(planned: Profile, profile: Profile) -> dict[str, str]:
    """Return the references of arms with another load than the plan's first one -> that load, in words."""
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
