"""A profile while a person edits it: the texts of a form, and the commented YAML that is made of them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from cellapp.cell.profile.draft_fields import (
    ARM_FIELDS,
    NAME_FIELD,
    OBSTACLE_FIELDS,
    PLAN_FIELDS,
    TRACKER_FIELDS,
    FormField,
    form_text,
    yaml_pairs,
    yaml_text,
    yaml_value,
)
from cellapp.cell.profile.loader import read_document
from cellapp.cell.profile.messages import KeyPath
from cellapp.ground.errors import InputError
from cellapp.ground.profile.obstacles import SHAPES, Obstacle
from drivers.arms.registry import ARMS
from drivers.trackers.registry import TRACKERS

SURVEYED = "From tracker points:"
"""Beginning of the comment that says where a base pose comes from."""
_WIDTH = 118
"""Longest line of YAML with its comment after it; if longer, the comment stands above."""


@dataclass(frozen=True)
class ArmDraft:
    """The fields of one arm, as typed; see ``draft_fields.ARM_FIELDS``.

    ``source`` is the arm's name in the edited file, empty for a new arm. ``note`` names the source of the base pose; it
    becomes a comment.
    """

    name: str = ""
    type: str = ""
    kind: str = ""
    host: str = ""
    serial: str = ""
    position: str = ""
    rpy: str = ""
    smr_offset: str = ""
    smr_normal: str = ""
    payload_mass: str = ""
    payload_center: str = ""
    limits: str = ""
    home: str = ""
    speed: str = ""
    source: str = ""
    note: str = ""


@dataclass(frozen=True)
class TrackerDraft:
    """The fields of the tracker, as typed."""

    kind: str = ""
    address: str = ""
    url: str = ""
    token_file: str = ""
    serial: str = ""
    position: str = ""
    rpy: str = ""


@dataclass(frozen=True)
class ObstacleDraft:
    """The fields of one obstacle, as typed; ``source`` as that of an arm."""

    name: str = ""
    shape: str = ""
    fixed_to: str = ""
    arm: str = ""
    position: str = ""
    rpy: str = ""
    size: str = ""
    radius: str = ""
    length: str = ""
    file: str = ""
    scale: str = ""
    source: str = ""


@dataclass(frozen=True)
class PlanDraft:
    """The fields of the plan, as typed."""

    stops: str = ""
    clearance: str = ""
    floor: str = ""


@dataclass(frozen=True)
class ProfileDraft:
    """The fields of a whole profile, as typed."""

    name: str = ""
    arms: tuple[ArmDraft, ...] = ()
    tracker: TrackerDraft = field(default_factory=TrackerDraft)
    obstacles: tuple[ObstacleDraft, ...] = ()
    plan: PlanDraft = field(default_factory=PlanDraft)


@dataclass(frozen=True)
class Filled:
    """One field of a draft: ``id`` such as "arms.0.host", its key in the profile, its text."""

    id: str
    form: FormField
    path: KeyPath
    text: str


def fields_of(draft: ProfileDraft) -> Iterator[Filled]:
    """Yield all fields that the draft's kinds of devices and shapes have, in the order of the form.

    Names of arms and of obstacles are not fields: they are keys.
    """
    yield Filled("name", NAME_FIELD, ("name",), draft.name)
    for index, arm in enumerate(draft.arms):
        yield from _section(f"arms.{index}", ("arms", arm.name), arm, ARM_FIELDS, driver_keys(arm.kind, ARMS))
    keys = driver_keys(draft.tracker.kind, TRACKERS)
    yield from _section("tracker", ("tracker",), draft.tracker, TRACKER_FIELDS, keys)
    for index, obstacle in enumerate(draft.obstacles):
        forms = [form for form in OBSTACLE_FIELDS if form.path[0] in obstacle_keys(obstacle.shape)]
        yield from _section(f"obstacles.{index}", ("obstacles", obstacle.name), obstacle, forms, frozenset())
    yield from _section("plan", ("plan",), draft.plan, PLAN_FIELDS, frozenset())


def with_text(draft: ProfileDraft, field_id: str, text: str) -> ProfileDraft:
    """Return the draft with one field changed; ``field_id`` as in ``Filled.id``, or a name as "arms.0.name"."""
    match field_id.split("."):
        case ["arms", index, name]:
            arms = list(draft.arms)
            arms[int(index)] = replace(arms[int(index)], **{name: text})
            return replace(draft, arms=tuple(arms))
        case ["obstacles", index, name]:
            obstacles = list(draft.obstacles)
            obstacles[int(index)] = replace(obstacles[int(index)], **{name: text})
            return replace(draft, obstacles=tuple(obstacles))
        case ["tracker", name]:
            return replace(draft, tracker=replace(draft.tracker, **{name: text}))
        case ["plan", name]:
            return replace(draft, plan=replace(draft.plan, **{name: text}))
        case ["name"]:
            return replace(draft, name=text)
        case _:
            raise KeyError(field_id)


def with_obstacles_of(draft: ProfileDraft, old: ProfileDraft) -> ProfileDraft:
    """Return the draft with obstacles that follow their arm's new name, and without those of arms that ``old`` had."""
    names = {arm.source: arm.name for arm in draft.arms if arm.source}
    gone = {arm.name for arm in old.arms} - {*names} - {arm.name for arm in draft.arms}
    obstacles = (replace(one, arm=names.get(one.arm, one.arm)) for one in draft.obstacles if one.arm not in gone)
    return replace(draft, obstacles=tuple(obstacles))


def arm_kinds() -> tuple[str, ...]:
    """Return the kinds of arm drivers."""
    return tuple(ARMS)


def tracker_kinds() -> tuple[str, ...]:
    """Return the kinds of tracker drivers."""
    return tuple(TRACKERS)


def driver_keys(kind: str, kinds: Mapping[str, type[Any]]) -> frozenset[str]:
    """Return the keys that the settings of a kind of device have; an unknown kind has ``kind`` alone."""
    return frozenset(kinds[kind].model_fields if kind in kinds else {"kind"})


def obstacle_keys(shape: str) -> frozenset[str]:
    """Return the keys that an obstacle of a shape has; an unknown shape has those that all shapes share."""
    return frozenset(SHAPES[shape].model_fields if shape in SHAPES else {"shape", *Obstacle.model_fields})


def needs_plant(draft: ProfileDraft) -> bool:
    """Return whether a device of the draft belongs to the simulated cell."""
    arms = [ARMS[arm.kind] for arm in draft.arms if arm.kind in ARMS]
    tracker = TRACKERS.get(draft.tracker.kind)
    return any(arm.needs_plant for arm in arms) or (tracker is not None and tracker.needs_plant)


# -- from a file ------------------------------------------------------------------------------------------------------


def draft_of(text: str, path: Path) -> ProfileDraft:
    """Return the draft of a profile's text, with units as written.

    Raises
    ------
    InputError
        If the text is no YAML with the sections of a profile, or the type of an arm is not a file.
    """
    return draft_of_data(read_document(text, path).data, str(path))


def draft_of_data(data: dict[str, Any], where: str) -> ProfileDraft:
    """Return the draft of a profile's plain data; ``where`` is the beginning of error messages."""
    arms = _mapping(data, "arms", where)
    for name in arms:
        if not isinstance(_mapping(arms, name, f"{where}: arms").get("type", ""), str):
            raise InputError(
                f"{where}: arms.{name}.type: the form edits arms whose type is a file; move these keys into a file such"
                " as arms/my-arm.yaml and name it here"
            )
    return ProfileDraft(
        name=form_text(data.get("name")),
        arms=tuple(ArmDraft(name=name, source=name, **_texts(arm, ARM_FIELDS)) for name, arm in arms.items()),
        tracker=TrackerDraft(**_texts(_mapping(data, "tracker", where), TRACKER_FIELDS)),
        obstacles=tuple(_obstacles(_mapping(data, "obstacles", where), f"{where}: obstacles")),
        plan=PlanDraft(**_texts(_mapping(data, "plan", where), PLAN_FIELDS)),
    )


def _obstacles(data: dict[str, Any], where: str) -> Iterator[ObstacleDraft]:
    for name in data:
        yield ObstacleDraft(name=name, source=name, **_texts(_mapping(data, name, where), OBSTACLE_FIELDS))


def file_name(draft: ProfileDraft) -> str:
    """Return the name of the file for a new profile of this name."""
    return f"{re.sub(r'[^A-Za-z0-9_-]+', '-', draft.name).strip('-') or 'cell'}.yaml"


def _mapping(data: dict[str, Any], key: str, where: str) -> dict[str, Any]:
    found = data.get(key)
    if found is None:
        return {}
    if not isinstance(found, dict):
        raise InputError(f"{where}: {key}: expected keys with values, got {form_text(found)}")
    return found


def _texts(section: dict[str, Any], forms: Sequence[FormField]) -> dict[str, str]:
    return {form.name: form_text(_at(section, form.path)) for form in forms}


def _at(data: Any, path: KeyPath) -> Any:
    for key in path:
        data = data.get(key) if isinstance(data, dict) else None
    return data


def _section(
    prefix: str, at: KeyPath, section: object, forms: Sequence[FormField], driver: frozenset[str]
) -> Iterator[Filled]:
    for form in forms:
        if form.path[0] != "driver" or form.path[1] in driver:
            yield Filled(f"{prefix}.{form.name}", form, (*at, *form.path), str(getattr(section, form.name)))


# -- commented YAML ---------------------------------------------------------------------------------------------------

_HEADER = """\
# A cell for cellapp. Check it with `cellapp doctor` before anything moves; ur10-ur5.yaml, which comes with cellapp
# (`cellapp init --from ur10-ur5`), explains the sections that may be added.
#
# A plain number is SI (m, rad, s, kg, degC); a text carries its unit: "0.3 mm", "90 deg", "500 g".
# Frames: C cell (z up), M tracker, B a robot's base, F its flange (the last D-H frame), S the SMR centre.
schema: cellapp-profile
version: 1
"""
_SEED = "seed: 1   # draws plan and splits; the same seed gives the same plan\n"
_FOOTER = """
calibration:
  robust: huber   # a knocked SMR or a wrong target in one stop does not spoil the rest
"""
PLANT = """
# The true simulated cell, drawn from `seed`. Only the simulated drivers read this section.
plant:
  seed: 7
"""


def draft_to_yaml(draft: ProfileDraft) -> str:
    """Return the draft as commented YAML without empty fields. ``load_profile`` reads it if the fields are valid."""
    filled = [item for item in fields_of(draft) if item.text.strip() or item.id == "name"]
    notes: dict[KeyPath, str] = {("arms", arm.name, "base"): arm.note for arm in draft.arms if arm.note}
    top, sections = filled[:1], filled[1:]
    text = _HEADER + "\n".join(_lines(top, 0, notes)) + "\n" + _SEED
    for _, items in groupby(sections, key=lambda item: item.path[0]):
        text += "\n" + "\n".join(_lines(list(items), 0, notes)) + "\n"
    return text + _FOOTER + (PLANT if needs_plant(draft) else "")


def _lines(items: Sequence[Filled], depth: int, notes: dict[KeyPath, str]) -> Iterator[str]:
    """Yield the lines of a block: a key with its value and comment on one line, or a key with its own block."""
    indent = "  " * depth
    for key, group in groupby(items, key=lambda item: item.path[depth]):
        members = list(group)
        at, form = members[0].path[: depth + 1], members[0].form
        if at in notes:
            yield f"{indent}# {' '.join(notes[at].split())}"
        if len(members[0].path) > depth + 1:
            yield f"{indent}{yaml_text(str(key))}:"
            yield from _lines(members, depth + 1, notes)
        elif form.shape == "ranges":
            yield from (f"{indent}# {form.help}", f"{indent}{yaml_text(str(key))}:")
            yield from (f"{indent}  - {pair}" for pair in yaml_pairs(members[0].text))
        else:
            line = f"{indent}{yaml_text(str(key))}: {yaml_value(form.shape, members[0].text)}"
            both = f"{line}   # {form.help}"
            yield from [both] if len(both) <= _WIDTH else [f"{indent}# {form.help}", line]
