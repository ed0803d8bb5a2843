"""Convert targets to and from text: the commented YAML of a list, and the fields where a person types one."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import yaml
from pydantic import ValidationError

from cellapp.cell.profile.messages import KeyPath, dotted, value_message
from cellapp.cell.targets.target_source import location
from cellapp.cell.targets.targets import Partner, Target, WorkFrame, WorkingConditions, frame_names, set_problem
from cellapp.ground.profile import Profile
from drivers.quantities import parse_quantity

_HEADER = """\
# Targets: SMR position x, y, z and flange roll, pitch, yaw (R = rot_z(yaw) rot_y(pitch) rot_x(roll)) in a frame: base
# (the arm's own, the default), tracker, the name of an arm, or one of `frames`. Without a rotation any will do.
# A plain number is m or rad; others carry a unit: "250 mm", "90 deg". tolerance: how far the SMR may be off.
schema: cellapp-targets
version: 1
"""
_WHOLE = re.compile(r"[-+]?(0|[1-9][0-9]*)")
_NUMBER = re.compile(rf"({_WHOLE.pattern}(\.[0-9]*)?|[-+]?\.[0-9]+)([eE][-+]?[0-9]+)?")
"""Not 010, which YAML reads as eight, nor 1_0."""


@dataclass(frozen=True)
class FormField:
    """One field of a target that a person types: its key, how its text is read, its label, and what belongs there.

    ``shape`` is a word (text), a number with a unit or without (value), or such values with commas (vector).
    """

    name: str
    shape: Literal["text", "value", "vector"]
    label: str
    help: str


FIELDS = (
    FormField("name", "text", "Name", "of its own; tables and charts use it"),
    FormField("arm", "text", "Arm", "the arm that goes there; the right arrow completes it"),
    FormField("frame", "text", "Frame", "base, tracker, an arm or a work frame; empty: the arm's own base"),
    FormField("position", "vector", "Position", "x, y, z of the SMR in the frame: 250 mm, 0, 1"),
    FormField("rpy", "vector", "Rotation", "roll, pitch, yaw of the flange: 90 deg, 0, 0; empty: any"),
    FormField("tolerance", "value", "Tolerance", "how far the SMR may be off: 0.1 mm; may be empty"),
    FormField(
        "orientation_tolerance",
        "value",
        "Tolerance of rotation",
        "by what angle the flange may be off: 0.5 mrad; may be empty",
    ),
    FormField(
        "approach", "vector", "Approach", "sign of each joint's last motion, 0 for any: 1, 0, -1, 0, 0, 0; may be empty"
    ),
    FormField(
        "partner",
        "text",
        "Partner",
        "the other arm of a cooperative target, its SMR seen from this one: right: 0, 0, 100 mm; 180 deg, 0, 0",
    ),
)
"""Fields of a target that a person types."""
_OPTIONAL = frozenset({"frame", "rpy", "tolerance", "orientation_tolerance", "approach", "partner"})
_PARTS = {"position": ("x", "y", "z"), "rpy": ("roll", "pitch", "yaw")}


@dataclass(frozen=True)
class TypedTarget:
    """Target as typed; None if something is wrong: ``problems`` maps fields to what is wrong."""

    target: Target | None
    problems: Mapping[str, str]


def targets_text(targets: Sequence[Target]) -> str:
    """Return a list as commented YAML, which ``load_targets`` reads as exactly the same targets, bit for bit."""
    frames = {target.work_frame.name: target.work_frame for target in targets if target.work_frame is not None}
    usual = _usual_conditions(targets)
    sections = {
        "frames": {name: _frame_keys(frame) for name, frame in frames.items()},
        "conditions": {arm: _condition_keys(conditions) for arm, conditions in usual.items()},
    }
    lines = [_HEADER]
    for section, entries in sections.items():
        if entries:
            lines.append(f"{section}:\n")
            lines += [f"  {_flow(name)}: {_flow(keys)}\n" for name, keys in entries.items()]
    lines.append("targets:\n")
    return "".join([*lines, *(f"  - {_flow(_target_keys(target, usual))}\n" for target in targets)])


def new_texts(arm: str) -> dict[str, str]:
    """Return the texts of the fields for the first target of a list."""
    texts = dict.fromkeys((field.name for field in FIELDS), "")
    return {**texts, "name": f"{arm}-01", "arm": arm, "rpy": "0 deg, 0 deg, 0 deg"}


def typed_texts(target: Target) -> dict[str, str]:
    """Return the texts of the fields for a target, in mm and degrees."""
    partner = target.partner
    return {
        "name": target.name,
        "arm": target.arm,
        "frame": target.frame,
        "position": _lengths(target.position),
        "rpy": _angles(target.rpy),
        "tolerance": "" if target.tolerance_mm is None else f"{target.tolerance_mm:.10g} mm",
        "orientation_tolerance": ""
        if target.orientation_tolerance_mrad is None
        else f"{target.orientation_tolerance_mrad:.10g} mrad",
        "approach": ", ".join(map(str, target.approach or ())),
        "partner": ""
        if partner is None
        else "; ".join(filter(None, (f"{partner.arm}: {_lengths(partner.position)}", _angles(partner.rpy)))),
    }


def frame_choices(targets: Iterable[Target], profile: Profile) -> tuple[str, ...]:
    """Return the frames for a target of a list: those of the cell, and the list's work frames."""
    work_frames = dict.fromkeys(target.work_frame.name for target in targets if target.work_frame is not None)
    return (*frame_names(profile), *work_frames)


def typed_target(
    texts: Mapping[str, str], before: Target | None, others: Sequence[Target], profile: Profile
) -> TypedTarget:
    """Parse the fields of a target and check it by the rules of a target list.

    A field whose text is unchanged from ``before`` keeps that value to the last bit. ``others`` are the rest of the
    list: their work frames can be named, and conditions that all of them state for an arm apply to this target.
    """
    listed = [*others] if before is None else [before, *others]
    shown = {} if before is None else typed_texts(before)
    values: dict[str, object] = {}
    for field in FIELDS:
        text = texts[field.name]
        if shown.get(field.name) == text:
            values[field.name] = getattr(before, field.name)
        elif text.strip() or field.name not in _OPTIONAL:
            read = _partner_keys if field.name == "partner" else _read
            values[field.name] = read(field, text)
    frames = {target.work_frame.name: target.work_frame for target in listed if target.work_frame is not None}
    if (frame := values.get("frame")) in frames:
        values["work_frame"] = frames[str(frame)]
    _add_conditions(values, before, listed)
    try:
        target = Target.model_validate(values)
    except ValidationError as error:
        return TypedTarget(None, _problems(error))
    problem = set_problem(target, others, profile, frames)
    if problem is None:
        return TypedTarget(target, {})
    words = problem.text.removeprefix(":").strip().removeprefix(f"{problem.key}: ")
    return TypedTarget(None, {problem.key: words})


# -- a target that is typed -------------------------------------------------------------------------------------------


def _read(field: FormField, text: str) -> object:
    return text.strip() if field.shape == "text" else _scalar(text) if field.shape == "value" else _vector(text)


def _vector(text: str) -> object:
    items = [_scalar(item) for item in text.split(",")]
    return items[0] if len(items) == 1 and isinstance(items[0], str) else items


def _scalar(text: str) -> object:
    """Return a plain number as one; a number with a unit, and what is none, stays a text for the rules to judge."""
    text = text.strip()
    return (int(text) if _WHOLE.fullmatch(text) else float(text)) if _NUMBER.fullmatch(text) else text


def _partner_keys(field: FormField, text: str) -> object:
    """Return the keys of a partner typed as "arm: position; rotation"."""
    arm, found, pose = text.partition(":")
    position, _, rpy = pose.partition(";")
    if not found:
        return text
    vectors = {"position": position, "rpy": rpy}
    return {"arm": arm.strip()} | {key: _vector(vector) for key, vector in vectors.items() if vector.strip()}


def _add_conditions(values: dict[str, object], before: Target | None, listed: Sequence[Target]) -> None:
    """Add conditions, which have no field: those that the arm had before, else those of the list."""
    usual = _usual_conditions(listed)
    if before is not None and values.get("arm") == before.arm:
        values["conditions"] = before.conditions
    else:
        values["conditions"] = usual.get(str(values.get("arm")), WorkingConditions())
    partner = values.get("partner")
    if isinstance(partner, dict):
        had = None if before is None else before.partner
        same = had is not None and had.arm == partner["arm"]
        partner["conditions"] = had.conditions if had and same else usual.get(partner["arm"], WorkingConditions())
        partner["moves"] = had.moves if had and same else "both"


def _problems(error: ValidationError) -> dict[str, str]:
    """Return the first problem of each field, as text."""
    found: dict[str, str] = {}
    for details in error.errors(include_url=False):
        name, *inside = location(details)
        at = _part_words(str(name), tuple(inside))
        found.setdefault(str(name), f"{at}{value_message(details)}")
    return found


def _part_words(name: str, inside: KeyPath) -> str:
    """Return the name of the wrong part of a field, as a prefix of its message."""
    if name == "partner" and inside:
        return _part_words(str(inside[0]), inside[1:]) if inside[1:] else f"{inside[0]}: "
    part = _PARTS.get(name, ())
    if inside and isinstance(inside[0], int):
        return f"{part[inside[0]]}: " if inside[0] < len(part) else f"value {inside[0] + 1}: "
    return f"{dotted(inside)}: " if inside else ""


def _lengths(position: Sequence[float]) -> str:
    return ", ".join(f"{value * 1e3:.10g} mm" for value in position)


def _angles(rpy: Sequence[float] | None) -> str:
    return ", ".join(f"{math.degrees(value):.10g} deg" for value in rpy or ())


# -- a list that is written -------------------------------------------------------------------------------------------


def _usual_conditions(targets: Sequence[Target]) -> dict[str, WorkingConditions]:
    """Return the conditions of each arm that states the same ones at all its targets."""
    found: dict[str, WorkingConditions] = {}
    varied: set[str] = set()
    for target in targets:
        for part in (target, *(() if target.partner is None else (target.partner,))):
            if found.setdefault(part.arm, part.conditions) != part.conditions:
                varied.add(part.arm)
    return {arm: usual for arm, usual in found.items() if arm not in varied and usual != WorkingConditions()}


def _target_keys(target: Target, usual: Mapping[str, WorkingConditions]) -> dict[str, object]:
    """Return the keys of one target."""
    keys: dict[str, object] = {"name": target.name, "arm": target.arm}
    if target.frame != "base":
        keys["frame"] = target.frame
    keys |= _part_keys(target, usual)
    for name, kind, unit in (("tolerance", "length", "mm"), ("orientation_tolerance", "angle", "mrad")):
        if (value := getattr(target, name)) is not None:
            text = f"{value * 1e3:.12g} {unit}"  # in thousandths if that is exactly the same number
            keys[name] = text if parse_quantity(kind, text) == value else value
    if target.approach is not None:
        keys["approach"] = list(target.approach)
    if target.partner is not None:
        moves = {"moves": target.partner.moves} if target.holds_first else {}
        keys["partner"] = {"arm": target.partner.arm} | _part_keys(target.partner, usual) | moves
    return keys


def _part_keys(part: Target | Partner, usual: Mapping[str, WorkingConditions]) -> dict[str, object]:
    """Return position, rotation and conditions of one arm at a target."""
    keys: dict[str, object] = {"position": list(part.position)}
    if part.rpy is not None:
        keys["rpy"] = list(part.rpy)
    if part.arm not in usual and part.conditions != WorkingConditions():
        keys["conditions"] = _condition_keys(part.conditions)
    return keys


def _condition_keys(conditions: WorkingConditions) -> dict[str, object]:
    return conditions.model_dump(exclude_none=True)


def _frame_keys(frame: WorkFrame) -> dict[str, object]:
    points = [{"nominal": list(point.nominal), "measured": list(point.measured)} for point in frame.points]
    return {"in": frame.parent, "points": points}


def _flow(value: object) -> str:
    """Return a value as YAML on one line."""
    flow = yaml.dump(
        value, Dumper=yaml.CSafeDumper, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10**6
    )
    return str(flow).removesuffix("...\n").strip()
