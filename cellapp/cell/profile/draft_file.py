"""The file behind a form: opened with its text, saved only if nobody else changed it meanwhile."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace
from pathlib import Path

from cellapp.cell.profile.draft import (
    ArmDraft,
    PlanDraft,
    ProfileDraft,
    TrackerDraft,
    draft_of,
    draft_to_yaml,
    with_obstacles_of,
)
from cellapp.cell.profile.draft_check import Checked, check_draft, check_text, wrong_names
from cellapp.cell.profile.files import path_exists, write_new, write_text
from cellapp.cell.profile.starters import arm_type_files, copies
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError


@dataclass(frozen=True)
class OpenProfile:
    """A profile that is being edited.

    Attributes
    ----------
    path : Path
    text : str or None
        The file's text when it was opened or last saved; None for a new profile.
    draft : ProfileDraft
        The fields of this text; for a new profile, those that the form starts with.
    """

    path: Path
    text: str | None
    draft: ProfileDraft


@dataclass(frozen=True)
class NewText:
    """The text that saving would write, the comments that would be lost, and its validation.

    ``text`` is None if names of arms are missing or given twice: YAML cannot hold them.
    """

    text: str | None
    lost_comments: tuple[str, ...]
    checked: Checked


def blank_draft() -> ProfileDraft:
    """Return the fields of a new real cell: usual values; what only a person at the cell knows is empty."""
    arms = tuple(
        ArmDraft(
            name=name,
            type=arm_type,
            kind="ur",
            rpy="0, 0, 0 deg",
            smr_normal="0, 0, 1",
            home="0, -90 deg, 0, -90 deg, 0, 0",  # a UR arm upright
            speed="0.25",
        )
        for name, arm_type in (("left", "arms/ur10.yaml"), ("right", "arms/ur5.yaml"))
    )
    tracker = TrackerDraft(kind="lmf", rpy="0, 0, 0 deg")
    return ProfileDraft(arms=arms, tracker=tracker, plan=PlanDraft(stops="400", clearance="80 mm"))


def open_profile(path: Path) -> OpenProfile:
    """Open the file of a profile. Raise ``InputError`` if it cannot be read or is no profile that the form can edit."""
    text = _text(path)
    if text is None:
        raise InputError(f"{path}: file not found; give the path of a profile")
    return OpenProfile(path, text, draft_of(text, path))


def changed_on_disk(opened: OpenProfile) -> bool:
    """Return whether the file changed since it was opened or saved: saving would overwrite another's work."""
    return _text(opened.path) != opened.text


def new_text(opened: OpenProfile, draft: ProfileDraft) -> NewText:
    """Return the text that saving would write. Raise ``InputError`` if the opened text cannot be edited."""
    wrong = wrong_names(draft)
    if wrong:
        return NewText(None, (), Checked(wrong))
    if opened.text is None:
        return NewText(draft_to_yaml(draft), (), check_draft(draft, opened.path))
    from cellapp.cell.profile.draft_edit import edited_text  # loads ruamel.yaml

    edited = edited_text(opened.text, opened.path, draft)
    return NewText(edited.text, edited.lost_comments, check_text(edited.text, opened.path, draft))


def before_saving(opened: OpenProfile, new: NewText, *, changed: bool) -> tuple[str, ...]:
    """Return what a person must agree to before the text is written, in sentences; none for a new valid file.

    ``changed`` is the result of ``changed_on_disk``.
    """
    if new.text is None:
        return ()
    sentences = []
    if changed and opened.text is None:
        sentences.append(f"{opened.path} exists already; saving replaces it.")
    elif changed:
        sentences.append(f"{opened.path} was changed by others since it was opened; saving replaces their version.")
    elif opened.text is not None:
        lines = list(difflib.ndiff(opened.text.splitlines(), new.text.splitlines()))
        added, taken = (sum(line.startswith(mark) for line in lines) for mark in "+-")
        sentences.append(
            f"Saving changes {opened.path}: {counted(taken, 'line')} taken out, {counted(added, 'line')} put in."
        )
    if new.lost_comments:
        sentences.append(f"Comments that go with keys that are no longer there: {'; '.join(new.lost_comments)}.")
    if new.checked.problems:
        sentences.append(f"cellapp refuses this profile until it is corrected: {new.checked.problems[0]}.")
    return tuple(sentences)


def save(opened: OpenProfile, draft: ProfileDraft, new: NewText) -> OpenProfile:
    """Write the text of a draft, and beside it those arm types of the program that are not there yet.

    An existing file is overwritten: call ``changed_on_disk`` before. Raises ``InputError`` if a file cannot be written.
    """
    if new.text is None:
        raise InputError(f"{opened.path} cannot be written: {new.checked.problems[0]}")
    folder = opened.path.parent
    types = {arm.type for arm in draft.arms} & {f"arms/{path.name}" for path in arm_type_files()}
    write_new(copies(sorted(name for name in types if not path_exists(folder / name)), folder))
    write_text(opened.path, new.text)
    draft = with_obstacles_of(draft, opened.draft)
    stored = replace(
        draft,
        arms=tuple(replace(one, source=one.name) for one in draft.arms),
        obstacles=tuple(replace(one, source=one.name) for one in draft.obstacles),
    )
    return OpenProfile(opened.path, new.text, stored)


def save_new(folder: Path, draft: ProfileDraft, name: str) -> Path:
    """Write a new profile ``name`` into a folder; return its path.

    Raises
    ------
    InputError
        If a field is not valid, the file exists already, or it cannot be written; nothing was written then.
    """
    opened = OpenProfile(folder / name, None, draft)
    new = new_text(opened, draft)
    if new.checked.problems:
        raise InputError("\n".join(map(str, new.checked.problems)))
    if path_exists(opened.path):
        raise InputError(f"{opened.path} exists already; nothing was written. Give another name, or move it away")
    save(opened, draft, new)
    return opened.path


def _text(path: Path) -> str | None:
    """Return the text of a file with its line ends as they are; None if there is no file."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a profile") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text ({error.reason}); save the file as UTF-8") from None
