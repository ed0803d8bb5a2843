"""Targets as text: the commented YAML of a list, and the fields in which a person types one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import yaml
from pydantic import ValidationError

from cellapp.compensation.targets import Target, set_problem
from cellapp.profile import Profile
from cellapp.profile.draft_fields import FormField, yaml_value
from cellapp.profile.messages import value_message
from drivers.quantities import parse_quantity

_HEADER = """\
# Targets: SMR position x, y, z in the arm's own base frame B, flange roll, pitch, yaw
# (R = rot_z(yaw) rot_y(pitch) rot_x(roll)). A plain number is m or rad; others carry a unit: "250 mm", "90 deg".
# tolerance (optional): how far the SMR may be from its target.
schema: cellapp-targets
version: 1
targets:
"""
FIELDS = (
    FormField("name", ("name",), "text", "Name", "of its own; tables and charts use it"),
    FormField("arm", ("arm",), "text", "Arm", "the arm that goes there; the right arrow completes it"),
    FormField("position", ("position",), "vector", "Position", "x, y, z of the SMR in the base frame: 250 mm, 0, 1"),
    FormField("rpy", ("rpy",), "vector", "Rotation", "roll, pitch, yaw of the flange: 90 deg, 0, 0"),
    FormField("tolerance", ("tolerance",), "value", "Tolerance", "how far the SMR may be off: 0.1 mm; may be empty"),
)
"""What a person types of a target."""
_PARTS = {"position": ("x", "y", "z"), "rpy": ("roll", "pitch", "yaw")}


@dataclass(frozen=True)
class TypedTarget:
    """A target as typed; None while something is wrong, which ``problems`` says by the name of its field."""

    target: Target | None
    problems: Mapping[str, str]


def targets_text(targets: Sequence[Target]) -> str:
    """A list as commented YAML, which ``load_targets`` reads as the same targets, bit for bit."""
    lines = [f"  - {_flow(target)}\n" for target in targets]
    return _HEADER + "".join(lines)


def typed_texts(target: Target) -> dict[str, str]:
    """What the fields show of a target, in mm and degrees."""
    return {
        "name": target.name,
        "arm": target.arm,
        "position": ", ".join(f"{value * 1e3:.10g} mm" for value in target.position),
        "rpy": ", ".join(f"{math.degrees(value):.10g} deg" for value in target.rpy or ()),
        "tolerance": "" if target.tolerance_mm is None else f"{target.tolerance_mm:.10g} mm",
    }


def typed_target(
    texts: Mapping[str, str], before: Target | None, others: Sequence[Target], profile: Profile
) -> TypedTarget:
    """The target that the fields say, judged by the rules of a target list.

    A field that still shows what ``before`` has keeps that value to the last bit. ``others`` are the rest of the list.
    """
    shown = {} if before is None else typed_texts(before)
    values: dict[str, object] = {}
    for field in FIELDS:
        text = texts[field.name]
        if shown.get(field.name) == text:
            values[field.name] = getattr(before, field.name)
        elif text.strip() or field.name != "tolerance":
            values[field.name] = yaml.load(yaml_value(field.shape, text), Loader=yaml.CSafeLoader)
    try:
        target = Target.model_validate(values)
    except ValidationError as error:
        return TypedTarget(None, _problems(error))
    problem = set_problem(target, others, profile)
    if not problem:
        return TypedTarget(target, {})
    return TypedTarget(None, {"name" if target.arm in profile.arms else "arm": problem.removeprefix(":").strip()})


def _problems(error: ValidationError) -> dict[str, str]:
    """The first problem of each field in words."""
    found: dict[str, str] = {}
    for details in error.errors(include_url=False):
        name, *rest = details["loc"]
        part = _PARTS.get(str(name), ())
        at = f"{part[rest[0]]}: " if rest and isinstance(rest[0], int) and rest[0] < len(part) else ""
        found.setdefault(str(name), f"{at}{value_message(details)}")
    return found


def _flow(target: Target) -> str:
    """One target on one line."""
    values: dict[str, object] = {
        "name": target.name,
        "arm": target.arm,
        "position": list(target.position),
    }
    if target.rpy is not None:
        values["rpy"] = list(target.rpy)
    if target.tolerance is not None:
        text = f"{target.tolerance * 1e3:.12g} mm"  # in mm where that is the same number
        values["tolerance"] = text if parse_quantity("length", text) == target.tolerance else target.tolerance
    flow = yaml.safe_dump(values, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10**6)
    return str(flow).strip()
