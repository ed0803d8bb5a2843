"""Checks before commands are sent: arms, controllers, payloads and SMR mounts must be the calibrated ones.

Loads of a plan: which one is attached, who attaches the next one, and whether the controllers are set to it.

If the plan says so, an arm carries another load from some stop on. Then the arms go home, the cell is closed, and a
person attaches the load and sets the controller's payload; the cell is opened anew, and every driver checks the
payload. A simulated cell attaches its loads itself.

Identify the arm controllers of a run: recorded when it begins, compared whenever the cell is opened.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np
from pydantic import TypeAdapter

from cellapp.cell.driving.cell import Cell
from cellapp.cell.run import RunFile
from cellapp.cell.run.run_arms import CONTROLLERS_RESULT, STORED_CONTROLLERS, recorded_controllers
from cellapp.cell.safety.cell_bodies import require_arms
from cellapp.cell.targets.prediction import Command
from cellapp.cell.targets.ranges import conditions_of
from cellapp.ground.control import Stopped
from cellapp.ground.counting import first_few
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import SAME_PAYLOAD_KG, Profile
from cellapp.ground.profile import Arm as ArmProfile
from cellapp.ground.profile.device_plugins import plugins_of_devices
from cellapp.ground.shell import shell_word
from cellapp.robot.effects.registry import program_of
from cellapp.robot.kinematics.chain import same_chain
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import controller_rows, published_rows
from drivers.arms.protocol import Arm, ArmError, stale
from drivers.findings import ArmIdentity


def check_controllers(run: RunFile, cell: Cell, *, insist: bool | None = None) -> tuple[str, ...]:
    """Record new controllers in the run, compare the others with their record, and return the notes.

    The notes are logged, as all later ones. With ``insist``, a controller whose own D-H was changed since the run
    began, or is not that of the profile, is only noted; None if the verb has no such option.

    Raises
    ------
    HardwareError
        If an arm has another controller than the recorded one, or another calibration in it, or its controller does
        not answer. Nothing has moved.
    InputError
        If the record is damaged.
    """
    recorded = recorded_controllers(run)
    identities: dict[str, ArmIdentity] = {}
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
        run.write_document(
            CONTROLLERS_RESULT, STORED_CONTROLLERS.dump_json(identities | recorded, exclude_none=True).decode("utf-8")
        )
    cell.logs.append(run.log)
    for note in notes:
        run.log("warning", note)
    if plugins_of_devices(run.profile):
        run.log("info", f"devices opened by {program_of(run.profile)}")
    return tuple(notes)


def noting_controllers(run: RunFile, notes: list[str], *, insist: bool | None = None) -> Callable[[Cell], None]:
    """Return a callback for the opened cell, to be called before anything moves.

    It checks the controllers and adds the notes to ``notes``; it raises as ``check_controllers``.
    """

    def opened(cell: Cell) -> None:
        notes.extend(check_controllers(run, cell, insist=insist))

    return opened


def _query(arm: Arm) -> tuple[ArmIdentity, tuple[str, ...]]:
    try:
        found = arm.identify()
        warnings = arm.warnings()
    except ArmError as error:
        raise HardwareError(str(error)) from error
    rows = found.dh_rows if found.dh_checksum else None
    if rows is not None:  # a plug-in may give an array
        rows = tuple((float(theta), float(d), float(a), float(alpha)) for theta, d, a, alpha in rows)
    return ArmIdentity(found.model, found.serial, found.software, rows, found.dh_checksum), warnings


def _compare(name: str, before: ArmIdentity, now: ArmIdentity) -> list[str]:
    if before.serial and now.serial and before.serial != now.serial:
        raise HardwareError(
            f"arm {name}: the run began with controller {before.serial}, this one is {now.serial}; nothing was moved."
            " Start a new run for another arm"
        )
    if before.dh_checksum != now.dh_checksum:
        return [f"arm {name}: {stale(before.dh_checksum, now.dh_checksum)}"]
    return []


def _not_the_profiles(name: str, arm: ArmProfile, now: ArmIdentity) -> list[str]:
    """Return a message if the controller's calibration is not the one that is nominal in the profile; else empty."""
    if arm.factory is None or same_calibration(arm, now):
        return []
    has = f"another calibration ({now.dh_checksum})" if now.dh_checksum else "no calibration of its own"
    return [
        f"arm {name}: its controller has {has} than that of arms.{name}.factory"
        f" ({arm.factory.checksum or 'without a checksum'}); write it with 'cellapp doctor PROFILE --controllers"
        " FOLDER', then collect and calibrate again"
    ]


def same_calibration(arm: ArmProfile, controller: ArmIdentity) -> bool:
    """Return whether a controller computes with the rows that are nominal in the profile."""
    wanted, published = controller_rows(arm), published_rows(arm)
    has = published if controller.dh_rows is None else np.array(controller.dh_rows)
    return same_chain(wanted, has, published)


_SAME_MOUNT = 1e-6
"""Tolerance for equal offsets [m] and unit vectors: covers rounding when they are written."""
_MOST_NAMED = 3
"""Number of findings that one sentence lists; the others are only counted."""


def require_same_arms(profile: Profile, model: CellModel, commands: Sequence[Command]) -> None:
    """Raise ``InputError`` unless profile, model and commands are of the same arms and SMR mounts."""
    if not commands:
        raise InputError("push: there are no targets; give a list with at least one")
    require_arms(profile, model)
    for command in commands:
        if command.record.arm not in profile.arms:
            raise InputError(
                f"push: target '{command.target.name}' is for arm '{command.record.arm}', the profile has arms"
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
    notes = check_controllers(run, cell, insist=changed_controller)
    wrong = list(_wrong_payloads(run, cell, commands))
    if wrong:
        raise HardwareError(
            f"push: {'; '.join(first_few(wrong, most=_MOST_NAMED))}; nothing was moved. Set the payload of the"
            " load that the arm carries on its controller, or state it at the target (conditions.payload)"
        )
    return notes


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
    return f"({', '.join(f'{1e3 * x:z.3f}' for x in point)}) mm"


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
    for name in dict.fromkeys(command.record.arm for command in commands):
        try:
            has_kg = cell.arms[name].tool().payload_kg
        except ArmError as error:
            raise HardwareError(str(error)) from error
        if has_kg is None:
            continue
        own = [command for command in commands if command.record.arm == name]
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


Hung = Callable[[str], bool]
"""Callback: tells a person what to attach; returns whether it is attached, False if nobody is there."""

_HUNG = "hung_load"
"""Name of the document with the index of the attached load; part of the file format."""


def hung_load(run: RunFile) -> int:
    """Return the index of the load that was attached last; 0 in a run whose load was never changed."""
    return run.read_checked(_HUNG, TypeAdapter(int), 0, "restore the run from a copy")


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
                f"the next stops need another load: {words}; then 'cellapp collect {shell_word(run.folder)}"
                " --resume --payload"
                f" {answer}'"
            )
    if changes:
        carried = ", ".join(f"{name} {arm.payload.mass:g} kg" for name, arm in due.arms.items())
        run.log("info", f"loads: {carried}")
    if load != hangs:
        run.write_document(_HUNG, str(load))
    return due


def require_load(cell: Cell, profile: Profile) -> None:
    """Check that every arm of an open cell carries the profile's load and is set to it; a simulated cell attaches it.

    Raise ``HardwareError`` if a controller reports another payload, or does not answer. Nothing has moved.
    """
    for name, arm in profile.arms.items():
        if cell.plant is not None:
            cell.plant.set_payload(name, arm.payload.mass, np.array(arm.payload.center_of_mass))
        if misfit := known_payload(cell.arms[name], arm.payload.mass):
            raise HardwareError(
                f"arm {name}: not moved with {arm.payload.mass:g} kg: {misfit}; set it, then continue with --resume"
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


def other_loads(planned: Profile, profile: Profile) -> dict[str, str]:
    """Return the arms with another load than the plan's first one -> that load, in words."""
    loads = {name: arm.payload for name, arm in profile.arms.items() if arm.payload != planned.arms[name].payload}
    return {name: f" with {load.mass:g} kg" for name, load in loads.items()}


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
