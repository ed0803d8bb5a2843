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
from drivers.quantities import Length, Turn
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


class Target(Section):
    """One target: SMR position in the arm's base frame and flange rotation ``rot_z(yaw) rot_y(pitch) rot_x(roll)``.

    ``tolerance`` [m] is how far the SMR may be from it; None where that is not said.
    """

    name: Annotated[str, Field(min_length=1)]
    arm: str
    position: CellPoint
    rpy: tuple[Turn, Turn, Turn]
    tolerance: Annotated[Length, AfterValidator(_tolerance)] | None = None

    @property
    def tolerance_mm(self) -> float | None:
        """Tolerance [mm]."""
        return None if self.tolerance is None else self.tolerance * 1e3


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
    now = (target.name, target.arm, target.position, target.rpy, target.tolerance_mm)
    return now == (stored.name, stored.arm, stored.position, stored.rpy, stored.tolerance_mm)
