"""Target lists (YAML): desired SMR positions and flange rotations, read and checked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import AfterValidator, Field, ValidationError

from cellapp.errors import InputError
from cellapp.profile import CellPoint, Profile
from cellapp.profile.messages import value_message
from cellapp.results import TargetRecord
from drivers.quantities import Length, Mass, Temperature, Time, Turn
from drivers.settings import Section

_LOOSEST_M = 0.01
"""Arms that are not calibrated do better: what is beyond was meant in millimetres, as 0.1 without a unit."""


def _tolerance(value: float) -> float:
    if not 0.0 < value <= _LOOSEST_M:
        raise ValueError(
            f"expected a tolerance above 0 and at most {_LOOSEST_M * 1e3:g} mm, got {value:g} m;"
            f" a plain number is metres, write '{value:g} mm' for mm"
        )
    return value


class FramePoint(Section):
    """One point of a work frame: its coordinates in that frame and where it was measured [m]."""

    nominal: CellPoint
    measured: CellPoint


class WorkFrame(Section):
    """A work frame W, given by three or more points measured in ``parent``: "tracker" or the name of an arm (its base).

    The pose of W in ``parent`` is the rigid registration of the points.
    """

    name: Annotated[str, Field(min_length=1)]
    parent: str = "tracker"
    points: Annotated[tuple[FramePoint, ...], Field(min_length=3)]


class WorkingConditions(Section):
    """Conditions at a target that effects depend on; None where not stated.

    Attributes
    ----------
    payload : float or None
        [kg]; None: that of the profile.
    temperature : float or None
        Of arm and air [degC].
    time : float or None
        Since the run began [s]; None: now, the state at the end of the run.
    dwell : float or None
        Rest before the arm works or is measured [s].
    """

    payload: Mass | None = None
    temperature: Temperature | None = None
    time: Time | None = None
    dwell: Time | None = None


class Partner(Section):
    """The second arm of a cooperative target: where its SMR is, seen from the first arm's SMR.

    ``position`` [m] and ``rpy`` are in the frame with its origin at the first arm's SMR centre and the axes of the
    first arm's flange. Without ``rpy`` the rotation of the second flange is free.
    """

    arm: str
    position: CellPoint
    rpy: tuple[Turn, Turn, Turn] | None = None
    conditions: WorkingConditions = WorkingConditions()


class Target(Section):
    """One target: SMR position and flange rotation ``rot_z(yaw) rot_y(pitch) rot_x(roll)`` in a frame.

    Attributes
    ----------
    name, arm : str
    position : three numbers
        SMR centre [m].
    rpy : three numbers or None
        Roll, pitch, yaw [rad]; None: any rotation will do.
    frame : str
        "base": the arm's own base; "tracker"; the name of an arm: that arm's base; else the name of ``work_frame``.
    work_frame : WorkFrame or None
    tolerance : float or None
        How far the SMR may be from the target, and the distance between two SMRs from the wanted one [m].
    approach : signs or None
        Preferred sign of each joint's last motion, 0 where it does not matter; None: as the way leads.
    conditions : WorkingConditions
        Of ``arm``.
    partner : Partner or None
        The other arm of a cooperative target.
    """

    name: Annotated[str, Field(min_length=1)]
    arm: str
    position: CellPoint
    rpy: tuple[Turn, Turn, Turn] | None = None
    frame: str = "base"
    work_frame: WorkFrame | None = None
    tolerance: Annotated[Length, AfterValidator(_tolerance)] | None = None
    approach: tuple[Literal[-1, 0, 1], ...] | None = None
    conditions: WorkingConditions = WorkingConditions()
    partner: Partner | None = None

    @property
    def tolerance_mm(self) -> float | None:
        """Tolerance [mm]."""
        return None if self.tolerance is None else self.tolerance * 1e3

    @property
    def arms(self) -> tuple[str, ...]:
        """The arms that go there."""
        return (self.arm,) if self.partner is None else (self.arm, self.partner.arm)


class TargetList(Section):
    """A file of targets."""

    schema_: Literal["cellapp-targets"] = Field(alias="schema")
    version: Literal[1]
    targets: Annotated[tuple[Target, ...], Field(min_length=1)]


def load_targets(path: Path, profile: Profile) -> tuple[Target, ...]:
    """Read a target list (YAML). Raises ``InputError`` naming the file, the line and the target."""
    try:
        text = path.read_text(encoding="utf-8")
        content = yaml.load(text, Loader=yaml.CSafeLoader)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a target list (YAML)") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text; write the target list as UTF-8 YAML") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = "" if mark is None else f":{mark.line + 1}"
        raise InputError(f"{path}{line}: not YAML: {getattr(error, 'problem', 'cannot be read')}") from None
    try:
        listed = TargetList.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "the file"
        raise InputError(f"{path}:{_line_of(text, first['loc'])}: {key}: {value_message(first)}") from None
    for index, target in enumerate(listed.targets):
        if problem := set_problem(target, listed.targets[:index], profile):
            raise InputError(f"{path}:{_line_of(text, ('targets', index))}: target '{target.name}'{problem}")
    return listed.targets


def set_problem(target: Target, others: Iterable[Target], profile: Profile) -> str:
    """Why a target does not fit the cell or the other targets, to follow its name; empty if it does."""
    if target.arm not in profile.arms:
        return f": no arm '{target.arm}'; arms are {', '.join(profile.arms)}"
    if any(other.name == target.name for other in others):
        return " is listed twice; give every target its own name"
    return ""


def _line_of(text: str, location: Sequence[int | str]) -> int:
    """Line of the innermost part of a YAML text that a location leads to, from 1."""
    node = yaml.compose(text, Loader=yaml.CSafeLoader)
    for key in location:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
            node = node.value[key]
        elif isinstance(node, yaml.MappingNode):
            below = [value for name, value in node.value if name.value == key]
            if not below:
                break
            node = below[0]
    return 1 if node is None else node.start_mark.line + 1


def same_target(target: Target, stored: TargetRecord) -> bool:
    """Whether a stored result is about this target as it is now. A result of an earlier version does not say."""
    now = (target.name, target.frame, target.position, target.rpy, target.tolerance_mm)
    return stored.arm in target.arms and now == (
        stored.name,
        stored.frame,
        stored.position,
        stored.rpy,
        stored.tolerance_mm,
    )
