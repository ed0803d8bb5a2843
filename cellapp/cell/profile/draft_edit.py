"""Merging of an edited draft into the text of its profile: only edits change it; comments and other keys stay."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError

from cellapp.cell.profile.draft import (
    PLANT,
    SURVEYED,
    ArmDraft,
    ObstacleDraft,
    ProfileDraft,
    draft_of,
    driver_keys,
    fields_of,
    needs_plant,
    obstacle_keys,
    with_obstacles_of,
)
from cellapp.cell.profile.draft_fields import FormField, yaml_value
from cellapp.cell.profile.messages import KeyPath
from cellapp.ground.errors import InputError
from drivers.arms.registry import ARMS
from drivers.trackers.registry import TRACKERS

_COMMENT = re.compile(r"(?:^|\s)#(.*)$", re.MULTILINE)


@dataclass(frozen=True)
class EditedText:
    """The new text of a profile, and the comments that were lost with keys that the form removed."""

    text: str
    lost_comments: tuple[str, ...]


def edited_text(text: str, path: Path, draft: ProfileDraft) -> EditedText:
    """Return the profile's text with the fields of ``draft`` in it.

    Raises
    ------
    InputError
        If the text is no profile, or cannot be rewritten without a loss elsewhere.
    """
    old = draft_of(text, path)
    if old == draft:
        return EditedText(text, ())
    if "\r\n" in text:  # written by an editor on Windows: edited with plain line ends, kept as it was
        edited = edited_text(text.replace("\r\n", "\n"), path, draft)
        return EditedText(edited.text.replace("\n", "\r\n"), edited.lost_comments)
    draft = with_obstacles_of(draft, old)
    document = _load(text, path)
    if _dump(document) != _with_newline(text):
        raise InputError(
            f"{path}: an edit would change the layout of this YAML elsewhere; edit it by hand, or write a new profile"
        )
    _edit_arms(document, draft.arms)
    _edit_obstacles(document, draft.obstacles)
    tracker = document.setdefault("tracker", CommentedMap())
    if draft.tracker.kind != old.tracker.kind:
        _drop_keys(tracker.get("driver"), driver_keys(draft.tracker.kind, TRACKERS))
    before = {item.path: item.text for item in fields_of(_renamed(old, draft))}
    for item in fields_of(draft):
        if item.text.strip() != before.get(item.path, "").strip():
            _set(document, item.path, item.form, item.text.strip())
    result = _with_notes(_dump(document), path, old, draft)
    if needs_plant(draft) and "plant" not in document:
        result += PLANT
    return EditedText(result, tuple(_missing_comments(text, result)))


def _edit_arms(document: CommentedMap, arms: Sequence[ArmDraft]) -> None:
    """Remove, rename and add arms; where the kind of driver changes, remove keys that the new kind lacks."""
    listed = document.setdefault("arms", CommentedMap())
    names = {arm.source: arm.name for arm in arms if arm.source}
    _rename_keys(listed, names)
    _rename_keys(document.get("plant", {}).get("effects"), names)  # the hidden physics belongs to its arm
    for arm in arms:
        section = listed.setdefault(arm.name, CommentedMap())
        if section.get("driver", {}).get("kind") != arm.kind:
            _drop_keys(section.get("driver"), driver_keys(arm.kind, ARMS))


def _edit_obstacles(document: CommentedMap, obstacles: Sequence[ObstacleDraft]) -> None:
    """Remove, rename and add obstacles; where the shape changes, remove keys that the new one lacks."""
    if not obstacles:
        document.pop("obstacles", None)
        return
    if not isinstance(document.get("obstacles"), CommentedMap):
        _add(document, "obstacles", CommentedMap())
    listed = document["obstacles"]
    _rename_keys(listed, {one.source: one.name for one in obstacles if one.source})
    for one in obstacles:
        if one.name not in listed:
            _add(listed, one.name, CommentedMap())
        section = listed[one.name]
        if section.get("shape") != one.shape:
            _drop_keys(section, obstacle_keys(one.shape))


def _rename_keys(section: CommentedMap | None, names: Mapping[str, str]) -> None:
    """Rename keys, all at once as two may change places; remove those without a new name."""
    if not isinstance(section, CommentedMap):
        return
    order = list(section)
    moved = {old: section.pop(old) for old in order if names.get(old) != old}
    for place, old in enumerate(name for name in order if name in names):
        if old in moved:
            section.insert(place, names[old], moved[old])


def _with_notes(text: str, path: Path, old: ProfileDraft, draft: ProfileDraft) -> str:
    """Comment each changed base with its new source; the comment on a surveyed one is removed."""
    before = {arm.name: (arm.position, arm.rpy) for arm in _renamed(old, draft).arms}
    arms = _load(text, path)["arms"]
    lines = text.split("\n")
    for arm in reversed(draft.arms):  # from the end, so that the numbers of earlier lines stay valid
        section = arms[arm.name]
        if before.get(arm.name) == (arm.position, arm.rpy) or "base" not in section or section.fa.flow_style():
            continue
        line, column = section.lc.key("base")
        noted = lines[line - 1].strip().startswith(f"# {SURVEYED}")
        lines[line - noted : line] = [f"{' ' * column}# {arm.note}"] if arm.note else []
    return "\n".join(lines)


def _renamed(old: ProfileDraft, new: ProfileDraft) -> ProfileDraft:
    """Return the file's draft with the new names of arms and obstacles, without those that were removed."""
    arms = {one.name: one for one in old.arms}
    obstacles = {one.name: one for one in old.obstacles}
    return replace(
        old,
        arms=tuple(replace(arms[one.source], name=one.name) for one in new.arms if one.source in arms),
        obstacles=tuple(
            replace(obstacles[one.source], name=one.name) for one in new.obstacles if one.source in obstacles
        ),
    )


def _drop_keys(driver: CommentedMap | None, known: frozenset[str]) -> None:
    for key in [key for key in driver or () if key not in known]:
        assert driver is not None
        del driver[key]


def _set(document: CommentedMap, path: KeyPath, form: FormField, text: str) -> None:
    """Set or add a key, or remove it if the text is empty."""
    *parents, last = path
    section = document
    for key in parents:
        if not isinstance(section.get(key), CommentedMap):
            if not text:
                return
            _add(section, str(key), CommentedMap())
        section = section[key]
    if not text:
        section.pop(last, None)
        return
    value = _yaml().load(yaml_value(form.shape, text))
    old = section.get(last)
    if last not in section:
        _add(section, str(last), value)
    elif isinstance(old, CommentedSeq) and isinstance(value, CommentedSeq) and len(old) == len(value):
        _set_items(old, value)
    else:
        section[last] = value


def _set_items(old: CommentedSeq, new: CommentedSeq) -> None:
    """Set the items that differ, so that the others keep their notation."""
    for index, value in enumerate(new):
        inner = old[index]
        if isinstance(inner, CommentedSeq) and isinstance(value, CommentedSeq) and len(inner) == len(value):
            _set_items(inner, value)
        elif inner != value:
            old[index] = value


def _add(section: CommentedMap, key: str, value: Any) -> None:
    """Add a key before the last one, as comments after the last one belong to what follows the section."""
    block = section.fa.flow_style() is not True
    section.insert(len(section) - 1 if block and len(section) > 1 else len(section), key, value)


def _load(text: str, path: Path) -> CommentedMap:
    try:
        document: CommentedMap = _yaml().load(_with_newline(text))
    except YAMLError as error:
        raise InputError(
            f"{path}: not YAML that can be edited: {str(error).splitlines()[0]}; edit it by hand"
        ) from None
    return document


def _dump(document: CommentedMap) -> str:
    stream = io.StringIO()
    _yaml().dump(document, stream)
    return stream.getvalue()


def _yaml() -> YAML:
    """Create a round-trip reader and writer with the layout of the profiles that come with the program."""
    yaml = YAML(typ="rt")
    yaml.preserve_quotes = True
    yaml.width = 10**6
    yaml.indent(mapping=2, sequence=4, offset=2)
    return yaml


def _with_newline(text: str) -> str:
    return text if text.endswith("\n") else f"{text}\n"


def _missing_comments(old: str, new: str) -> list[str]:
    remaining = [found.strip() for found in _COMMENT.findall(new)]
    missing = []
    for comment in (found.strip() for found in _COMMENT.findall(old)):
        if comment in remaining:
            remaining.remove(comment)
        elif comment:
            missing.append(comment)
    return missing
