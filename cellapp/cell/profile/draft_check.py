"""Validation of a draft by the profile's own rules: each problem is reported at the field that it concerns."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from cellapp.cell.profile.draft import Filled, ProfileDraft, draft_to_yaml, fields_of, with_text
from cellapp.cell.profile.loader import locate_meshes, read_arm_types, read_document
from cellapp.cell.profile.messages import KeyPath, PlacedError, dotted, problems, value_message
from cellapp.ground.errors import InputError
from cellapp.ground.profile.obstacles import AnyObstacle, Obstacles
from cellapp.ground.profile.schema import Arm, Pose, Profile
from cellapp.ground.starters import starters_folder

_OBSTACLE: TypeAdapter[AnyObstacle] = TypeAdapter(AnyObstacle)


@dataclass(frozen=True)
class FieldProblem:
    """A problem of one field.

    Attributes
    ----------
    field : str
        As ``Filled.id``, or a name as "arms.0.name"; empty if the problem concerns no field of the form.
    key : str
        The key in the profile, as "arms.left.driver.host".
    words : str
        What is wrong and what was expected.
    """

    field: str
    key: str
    words: str

    def __str__(self) -> str:
        """Return the sentence with its key."""
        return f"{self.key}: {self.words}" if self.key else self.words


@dataclass(frozen=True)
class Checked:
    """A validated draft: its problems, the profile if there are none, and those poses that are valid anyway.

    Attributes
    ----------
    bases : mapping
        Arm -> pose of its base; None if that is not valid.
    tracker : Pose or None
    obstacles : mapping
        Name -> obstacle, of those that are valid.
    """

    problems: tuple[FieldProblem, ...]
    profile: Profile | None = None
    bases: Mapping[str, Pose | None] = field(default_factory=dict)
    tracker: Pose | None = None
    obstacles: Obstacles = field(default_factory=dict)


def check_draft(draft: ProfileDraft, path: Path) -> Checked:
    """Validate a draft that is to be written to ``path``; types of arms may also come with the program."""
    wrong = wrong_names(draft)
    return Checked(wrong) if wrong else check_text(draft_to_yaml(draft), path, draft)


def check_text(text: str, path: Path, draft: ProfileDraft) -> Checked:
    """Validate the text of a profile for ``path``, as ``load_profile`` does; ``draft`` holds its fields."""
    fields = tuple(fields_of(draft))
    wrong = wrong_names(draft)
    if wrong:
        return Checked(wrong)
    try:
        document = read_document(text, path)
        read_arm_types(document, (path.parent, starters_folder()))
        locate_meshes(document, (path.parent, starters_folder()))
    except PlacedError as error:
        return Checked((_at_field(error.place.inside, error.words, draft, fields),))
    except InputError as error:
        return Checked((FieldProblem("", "", str(error)),))
    bases = {arm.name: _pose(document.data, ("arms", arm.name, "base")) for arm in draft.arms}
    tracker = _pose(document.data, ("tracker", "pose"))
    obstacles = _obstacles(document.data.get("obstacles"))
    try:
        return Checked((), Profile.model_validate(document.data), bases, tracker, obstacles)
    except ValidationError as error:
        found = problems(error, document)
        told = tuple(_at_field(at, words, draft, fields) for at, words in found)
        return Checked(told, None, bases, tracker, obstacles)


def arm_and_tracker_pose(draft: ProfileDraft, index: int, path: Path) -> tuple[Arm, Pose]:
    """Return one arm without its base, and the tracker's pose, of a draft that may be invalid elsewhere.

    Raises
    ------
    InputError
        If the arm or the tracker's pose are not valid.
    """
    unplaced = with_text(with_text(draft, f"arms.{index}.position", ""), f"arms.{index}.rpy", "")
    document = read_document(draft_to_yaml(unplaced), path)
    read_arm_types(document, (path.parent, starters_folder()))
    data = document.data
    if "pose" not in data.get("tracker", {}):
        raise InputError("tracker.pose: missing; points in the tracker frame give a base only with the tracker's pose")
    name = draft.arms[index].name
    at: KeyPath = ("arms", name)
    try:
        arm = Arm.model_validate({**data["arms"][name], "driver": {"kind": "none"}})  # the pose needs no driver
        at = ("tracker", "pose")
        return arm, Pose.model_validate(data["tracker"]["pose"])
    except ValidationError as error:
        details = error.errors(include_url=False)[0]
        raise InputError(f"{dotted((*at, *details['loc']))}: {value_message(details)}; correct it first") from None


def wrong_names(draft: ProfileDraft) -> tuple[FieldProblem, ...]:
    """Return names of arms and obstacles that are empty or given twice: they cannot be written as keys."""
    arms, obstacles = ([one.name for one in several] for several in (draft.arms, draft.obstacles))
    return (*_wrong_keys("arms", "arm", "left", arms), *_wrong_keys("obstacles", "obstacle", "table", obstacles))


def _wrong_keys(section: str, what: str, example: str, names: Sequence[str]) -> Iterator[FieldProblem]:
    for index, name in enumerate(names):
        if not name.strip() or names.count(name) > 1:
            why = f"missing; each {what} needs a name, such as {example}"
            words = f"given twice; each {what} needs a name of its own" if name.strip() else why
            yield FieldProblem(f"{section}.{index}.name", f"{section}[{index}]", words)


def _obstacles(data: Any) -> Obstacles:
    """Return the valid obstacles of a profile's data."""
    found: Obstacles = {}
    for name, one in data.items() if isinstance(data, dict) else ():
        with contextlib.suppress(ValidationError):
            found[name] = _OBSTACLE.validate_python(one)
    return found


def _pose(data: Any, path: Sequence[str]) -> Pose | None:
    """Return a pose of a profile's data; None if it is missing or not valid."""
    for key in path:
        data = data.get(key) if isinstance(data, dict) else None
    try:
        return Pose.model_validate(data)
    except ValidationError:
        return None


def _at_field(at: KeyPath, words: str, draft: ProfileDraft, fields: Sequence[Filled]) -> FieldProblem:
    """Report a problem at the field whose key contains its key, else at the first field inside it, else at none."""
    around = (item for item in fields if at[: len(item.path)] == item.path)
    inside = (item for item in fields if item.path[: len(at)] == at and len(at) > 1)
    found = next(around, None) or next(inside, None)
    return FieldProblem("" if found is None else found.id, dotted(at), words)
