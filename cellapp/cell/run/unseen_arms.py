"""Arms that were not seen at rest after a halt: a run keeps them until data or a person confirm that they rest."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

from pydantic import TypeAdapter, ValidationError

from cellapp.cell.run.file import RunFile
from cellapp.cell.run.sqlite_file import utc_now
from cellapp.ground.errors import InputError
from cellapp.ground.progress import Halt

_DOCUMENT = "not seen at rest: {arm}"
"""Name of one document per arm, so that two arms whose links break at once do not overwrite each other."""
BY_DATA = "its controller reports that it rests"
BY_PERSON = "a person has seen it at rest"


@dataclass(frozen=True)
class UnseenArm:
    """Since when (UTC) an arm counts as moving, and why it was not seen at rest."""

    since: str
    reason: str


_STORED = TypeAdapter(UnseenArm | None)


def unseen_arms(run: RunFile) -> dict[str, UnseenArm]:
    """Return the arms of a run that must be treated as moving, arm -> since when and why."""
    found = {name: _read(run, name) for name in run.profile.arms}
    return {name: arm for name, arm in found.items() if arm is not None}


def note_halt(run: RunFile, arm: str, halt: Halt) -> None:
    """Record the end of an arm's halt; an error such as a full disk must not prevent care for the other arms."""
    with contextlib.suppress(InputError):
        if halt.state == "not seen at rest":
            _note_unseen(run, arm, halt.reason)
        elif halt.state == "at rest":
            note_at_rest(run, arm, BY_DATA)


def note_at_rest(run: RunFile, arm: str, how: str) -> bool:
    """Record that an arm rests, and how that is known; return whether it counted as moving.

    Raises ``InputError`` if the run has no such arm or cannot be written.
    """
    if arm not in run.profile.arms:
        raise InputError(f"{run.folder}: arm '{arm}' not found; arms are {', '.join(run.profile.arms)}")
    before = _read(run, arm)
    if before is None:
        return False
    run.write_result(_DOCUMENT.format(arm=arm), "null")
    run.log("info", f"arm {arm}: at rest: {how}; it counted as moving since {before.since}")
    return True


def _note_unseen(run: RunFile, arm: str, reason: str) -> None:
    before = _read(run, arm)
    since = utc_now() if before is None else before.since
    run.write_result(_DOCUMENT.format(arm=arm), _STORED.dump_json(UnseenArm(since, reason)).decode())
    run.log("error", f"arm {arm}: NOT SEEN AT REST, treat it as moving: {reason}")


def _read(run: RunFile, arm: str) -> UnseenArm | None:
    text = run.read_result(_DOCUMENT.format(arm=arm))
    try:
        return None if text is None else _STORED.validate_json(text)
    except ValidationError:  # a damaged record must not make an arm look safe
        return UnseenArm("an unknown time", "the run's record of it is damaged")
