"""Judging a draft by the profile's own rules: each problem is told at the field that it concerns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from cellapp.errors import InputError
from cellapp.profile.draft import Filled, ProfileDraft, draft_to_yaml, fields_of
from cellapp.profile.loader import read_arm_types, read_document
from cellapp.profile.messages import KeyPath, PlacedError, dotted, problems
from cellapp.profile.schema import Profile
from cellapp.profile.starters import starters_folder


@dataclass(frozen=True)
class FieldProblem:
    """What is wrong with one field.

    Attributes
    ----------
    field : str
        As ``Filled.id``, or "arms.0.name"; empty if the problem concerns no field of the form.
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
    """A judged draft: its problems, and the profile if there are none."""

    problems: tuple[FieldProblem, ...]
    profile: Profile | None = None


def check_draft(draft: ProfileDraft, path: Path) -> Checked:
    """Judge a draft that is to be written to ``path``; types of arms may also be those that come with the program."""
    wrong = _wrong_names(draft)
    return Checked(wrong) if wrong else check_text(draft_to_yaml(draft), path, draft)


def check_text(text: str, path: Path, draft: ProfileDraft) -> Checked:
    """Judge the text of a profile for ``path``, as ``load_profile`` does; ``draft`` holds its fields."""
    fields = tuple(fields_of(draft))
    wrong = _wrong_names(draft)
    if wrong:
        return Checked(wrong)
    try:
        document = read_document(text, path)
        read_arm_types(document, (path.parent, starters_folder()))
    except PlacedError as error:
        return Checked((_at_field(error.place.inside, error.words, draft, fields),))
    except InputError as error:
        return Checked((FieldProblem("", "", str(error)),))
    try:
        return Checked((), Profile.model_validate(document.data))
    except ValidationError as error:
        found = problems(error, document)
        return Checked(tuple(_at_field(at, words, draft, fields) for at, words in found))


def _wrong_names(draft: ProfileDraft) -> tuple[FieldProblem, ...]:
    """Names of arms that are empty or given twice: as keys they could not even be written."""
    counts = Counter(arm.name for arm in draft.arms)
    words = {0: "missing; each arm needs a name, such as left", 2: "given twice; each arm needs a name of its own"}
    return tuple(
        FieldProblem(f"arms.{index}.name", f"arms[{index}]", words[0 if not arm.name.strip() else 2])
        for index, arm in enumerate(draft.arms)
        if not arm.name.strip() or counts[arm.name] > 1
    )


def _at_field(at: KeyPath, words: str, draft: ProfileDraft, fields: Sequence[Filled]) -> FieldProblem:
    """The field whose key contains the key of a problem, else the first one inside it, else none."""
    around = (item for item in fields if at[: len(item.path)] == item.path)
    inside = (item for item in fields if item.path[: len(at)] == at and len(at) > 1)
    found = next(around, None) or next(inside, None)
    return FieldProblem("" if found is None else found.id, dotted(at), words)
