"""The answers file of ``cellapp init``: the keys of a profile as in the form, and tracker points for a base."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from cellapp.cell.profile.draft import ProfileDraft, draft_of_data, fields_of, file_name
from cellapp.cell.profile.draft_file import save_new
from cellapp.cell.profile.loader import load_text
from cellapp.cell.profile.messages import Document, KeyPath, dotted, value_message
from cellapp.cell.profile.starters import FOLDER, arm_type_files
from cellapp.cell.profile.survey_points import SurveyPoint
from cellapp.commands.doctor.survey import draft_with_surveyed_base
from cellapp.ground.errors import InputError

_POINTS = TypeAdapter(tuple[SurveyPoint, ...])
_HEAD = ("schema", "version", "seed")
"""Keys of a profile that answers may contain, but that the program writes itself."""


@dataclass(frozen=True)
class Written:
    """A profile that was written, and notes on it."""

    path: Path
    notes: tuple[str, ...]


def write_answers(answers: Path, folder: Path) -> Written:
    """Write the profile of an answers file into ``folder/profiles``.

    Raises
    ------
    InputError
        If an answer is missing or wrong, points do not fix a base, or the file exists or cannot be written.
    """
    document = load_text(answers)
    surveys = _taken_points(document)
    draft = _with_type_files(draft_of_data(document.data, str(answers)))
    _check_keys(document, draft)
    profiles = folder / FOLDER
    target = profiles / file_name(draft)
    notes = []
    for name, points in surveys.items():
        index = [arm.name for arm in draft.arms].index(name)
        try:
            draft, found = draft_with_surveyed_base(draft, index, points, target)
        except InputError as error:
            raise InputError(f"{answers}: arms.{name}.base.points: {error}") from None
        notes.append(f"arm {name}: {found.fit.sentence}")
    return Written(save_new(profiles, draft, target.name), tuple(notes))


def _with_type_files(draft: ProfileDraft) -> ProfileDraft:
    """Return the draft with short names of arm types, such as ur10, replaced by their files."""
    files = {path.stem: f"arms/{path.name}" for path in arm_type_files()}
    return replace(draft, arms=tuple(replace(arm, type=files.get(arm.type, arm.type)) for arm in draft.arms))


def _taken_points(document: Document) -> Mapping[str, tuple[SurveyPoint, ...]]:
    """Remove the points of each base from the answers and parse them."""
    arms = document.data.get("arms")
    surveys = {}
    for name, arm in (arms if isinstance(arms, dict) else {}).items():
        base = arm.get("base") if isinstance(arm, dict) else None
        if isinstance(base, dict) and "points" in base:
            at: KeyPath = ("arms", name, "base", "points")
            if len(base) > 1:
                raise InputError(f"{document.places[at]}: give points or a pose, not both")
            surveys[name] = _points(document, at, base.pop("points"))
    return surveys


def _points(document: Document, at: KeyPath, listed: object) -> tuple[SurveyPoint, ...]:
    try:
        return _POINTS.validate_python(tuple(listed) if isinstance(listed, list) else listed)
    except ValidationError as error:
        details = error.errors(include_url=False)[0]
        inside = (*at, *details["loc"])
        raise InputError(f"{document.places[at].file}: {dotted(inside)}: {value_message(details)}") from None


def _check_keys(document: Document, draft: ProfileDraft) -> None:
    known = {item.path for item in fields_of(draft)}
    for path in _leaves(document.data, ()):
        if path[0] not in _HEAD and not any(path[: len(field)] == field for field in known):
            beside = sorted({dotted(field) for field in known if field[: len(path) - 1] == path[:-1]})
            listed = f"; known here are {', '.join(beside)}" if beside else ""
            raise InputError(f"{document.places[path]}: the form has no such key{listed}; add it to the profile later")


def _leaves(data: dict[str, Any], at: KeyPath) -> Iterator[KeyPath]:
    for key, value in data.items():
        if isinstance(value, dict):
            yield from _leaves(value, (*at, key))
        else:
            yield (*at, key)
