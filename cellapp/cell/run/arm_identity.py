"""Controllers that a run has recorded, and the identity of its arms: by serial numbers where known, else by names."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from cellapp.cell.run.file import RunFile
from cellapp.ground.errors import InputError

IdentityBasis = Literal["controller", "profile", "names"]
"""An arm is known by the serial number of its controller, by that in the profile, or only by the names of profile and
arm with its type."""
CONTROLLERS_RESULT = "controllers"
"""Name of the stored result: arm -> identity of its controller."""


@dataclass(frozen=True)
class ControllerIdentity:
    """Identity that a controller reports; ``dh_checksum`` identifies the factory calibration of its D-H rows.

    ``dh_rows`` are the rows theta, d, a, alpha of such a calibration [rad, m]; None without one.
    """

    model: str
    serial: str
    software: str
    dh_checksum: str
    dh_rows: tuple[tuple[float, float, float, float], ...] | None = None


STORED_CONTROLLERS = TypeAdapter(dict[str, ControllerIdentity])


@dataclass(frozen=True)
class ArmIdentity:
    """Identity of an arm; ``key`` is the same in all its runs, ``serial`` is empty where only names are known."""

    key: str
    known_by: IdentityBasis
    serial: str = ""

    def is_other_than(self, other: ArmIdentity) -> bool:
        """Return whether serial numbers prove two arms to be different ones."""
        return self.known_by == other.known_by and bool(self.serial) and self.serial != other.serial


def recorded_controllers(run: RunFile) -> dict[str, ControllerIdentity]:
    """Return the controllers that a run has recorded, by arm. Raise ``InputError`` if the record is damaged."""
    text = run.read_result(CONTROLLERS_RESULT)
    if text is None:
        return {}
    try:
        return STORED_CONTROLLERS.validate_json(text)
    except ValidationError:
        raise InputError(f"{run.path}: the record of its controllers is damaged; start a new run") from None


def arm_identities(run: RunFile) -> Mapping[str, ArmIdentity]:
    """Identify every arm of the run's profile: by its controller's serial, by the profile's, or by names.

    A simulated arm has no serial number of its own: all of them report the same one.
    """
    controllers, found = dict[str, ControllerIdentity](), dict[str, ArmIdentity]()
    with suppress(InputError):  # a damaged record: names then identify the arms
        controllers = recorded_controllers(run)
    for name, arm in run.profile.arms.items():
        controller = controllers.get(name)
        given = run.profile.traceability.arms.get(name)
        if controller is not None and controller.serial and not arm.driver.needs_plant:
            found[name] = ArmIdentity(controller.serial, "controller", controller.serial)
        elif given is not None and given.serial:
            found[name] = ArmIdentity(given.serial, "profile", given.serial)
        else:
            found[name] = ArmIdentity(f"{run.profile.name}, {name} ({arm.type.model})", "names")
    return found
