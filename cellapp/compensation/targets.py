"""Target lists (YAML): desired SMR positions and flange rotations, read and checked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import Field, ValidationError

from cellapp.errors import InputError
from cellapp.profile import CellPoint, Profile
from cellapp.profile.messages import value_message
from drivers.quantities import Turn
from drivers.settings import Section


class Target(Section):
    """One target: SMR position in the arm's base frame and flange rotation ``rot_z(yaw) rot_y(pitch) rot_x(roll)``."""

    name: str
    arm: str
    position: CellPoint
    rpy: tuple[Turn, Turn, Turn]


class TargetList(Section):
    """A file of targets."""

    schema_: Literal["cellapp-targets"] = Field(alias="schema")
    version: Literal[1]
    targets: Annotated[tuple[Target, ...], Field(min_length=1)]


def load_targets(path: Path, profile: Profile) -> tuple[Target, ...]:
    """Read a target list (YAML). Raises ``InputError`` naming the file and the target."""
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
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
        raise InputError(f"{path}: {key}: {value_message(first)}") from None
    names = set()
    for target in listed.targets:
        if target.arm not in profile.arms:
            arms = ", ".join(profile.arms)
            raise InputError(f"{path}: target '{target.name}': no arm '{target.arm}'; arms are {arms}")
        if target.name in names:
            raise InputError(f"{path}: target '{target.name}' is listed twice; give every target its own name")
        names.add(target.name)
    return listed.targets
