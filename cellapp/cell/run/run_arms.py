"""Controllers that a run has recorded, and the identity of its arms: by serial numbers where known, else by names.

Arms that were not seen at rest after a halt: a run keeps them until data or a person confirm that they rest.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from cellapp.cell.run.file import RunFile
from cellapp.cell.run.sqlite_file import utc_now
from cellapp.ground.errors import InputError
from cellapp.ground.progress import Halt
from drivers.findings import ArmIdentity

IdentityBasis = Literal["controller", "profile", "names"]
"""An arm is known by the serial number of its controller, by that in the profile, or only by the names of profile and
arm with its type."""
CONTROLLERS_RESULT = "controllers"
"""Name of the stored result: arm -> identity of its controller."""


STORED_CONTROLLERS = TypeAdapter(dict[str, ArmIdentity])
"""Rows of D-H are stored only where they are of a factory calibration, which has a checksum."""


@dataclass(frozen=True)
class StoredIdentity:
    """Identity of an arm; ``key`` is the same in all its runs, ``serial`` is empty where only names are known."""

    key: str
    known_by: IdentityBasis
    serial: str = ""

    def is_other_than(self, other: StoredIdentity) -> bool:
        """Return whether serial numbers prove two arms to be different ones."""
        return self.known_by == other.known_by and bool(self.serial) and self.serial != other.serial


def recorded_controllers(run: RunFile) -> dict[str, ArmIdentity]:
    """Return the controllers that a run has recorded, by arm. Raise ``InputError`` if the record is damaged."""
    return run.read_checked(CONTROLLERS_RESULT, STORED_CONTROLLERS, {}, "start a new run")


def arm_identities(run: RunFile) -> Mapping[str, StoredIdentity]:
    """Identify every arm of the run's profile: by its controller's serial, by the profile's, or by names.

    A simulated arm has no serial number of its own: all of them report the same one.
    """
    controllers, found = dict[str, ArmIdentity](), dict[str, StoredIdentity]()
    with suppress(InputError):  # a damaged record: names then identify the arms
        controllers = recorded_controllers(run)
    for name, arm in run.profile.arms.items():
        controller = controllers.get(name)
        given = run.profile.traceability.arms.get(name)
        if controller is not None and controller.serial and not arm.driver.needs_plant:
            found[name] = StoredIdentity(controller.serial, "controller", controller.serial)
        elif given is not None and given.serial:
            found[name] = StoredIdentity(given.serial, "profile", given.serial)
        else:
            found[name] = StoredIdentity(f"{run.profile.name}, {name} ({arm.type.model})", "names")
    return found


_DOCUMENT = "not seen at rest: {arm}"
"""Name of one document per arm, so that two arms whose links break at once do not overwrite each other."""
BY_DATA = "its controller reports that it rests"
BY_PERSON = "a person has seen it at rest"


@dataclass(frozen=True)
class UnseenArm:
    """Since when (UTC) an arm counts as moving, and why it was not seen at rest."""

    since: str
    reason: str


_STORED = TypeAdapter(UnseenArm | None)


def unseen_arms(run: RunFile) -> dict[str, UnseenArm]:
    """Return the arms of a run that must be treated as moving, arm -> since when and why."""
    found = {name: _read(run, name) for name in run.profile.arms}
    return {name: arm for name, arm in found.items() if arm is not None}


def note_halt(run: RunFile, arm: str, halt: Halt) -> None:
    """Record the end of an arm's halt; an error such as a full disk must not prevent care for the other arms."""
    with contextlib.suppress(InputError):
        if halt.state == "not seen at rest":
            _note_unseen(run, arm, halt.reason)
        elif halt.state == "at rest":
            note_at_rest(run, arm, BY_DATA)


def note_at_rest(run: RunFile, arm: str, how: str) -> bool:
    """Record that an arm rests, and how that is known; return whether it counted as moving.

    Raises ``InputError`` if the run has no such arm or cannot be written.
    """
    if arm not in run.profile.arms:
        raise InputError(f"{run.folder}: arm '{arm}' not found; arms are {', '.join(run.profile.arms)}")
    before = _read(run, arm)
    if before is None:
        return False
    run.write_document(_DOCUMENT.format(arm=arm), "null")
    run.log("info", f"arm {arm}: at rest: {how}; it counted as moving since {before.since}")
    return True


def _note_unseen(run: RunFile, arm: str, reason: str) -> None:
    before = _read(run, arm)
    since = utc_now() if before is None else before.since
    run.write_document(_DOCUMENT.format(arm=arm), _STORED.dump_json(UnseenArm(since, reason)).decode())
    run.log("error", f"arm {arm}: NOT SEEN AT REST, treat it as moving: {reason}")


def _read(run: RunFile, arm: str) -> UnseenArm | None:
    text = run.read_document(_DOCUMENT.format(arm=arm))
    try:
        return None if text is None else _STORED.validate_json(text)
    except ValidationError:  # a damaged record must not make an arm look safe
        return UnseenArm("an unknown time", "the run's record of it is damaged")
