"""The record of the rungs of a rehearsal beside a profile."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from cellapp.cell.driving.records import RehearseResult
from cellapp.cell.driving.rehearsal_rungs import RUNGS, RungName
from cellapp.cell.run import RunFile
from cellapp.cell.run.file import noted_profile, rehearsals_path
from cellapp.ground.errors import InputError
from cellapp.ground.file_text import file_text
from cellapp.ground.outputs import RENEWED
from cellapp.ground.profile import Profile
from cellapp.ground.results import Result


class RehearsalLog(Result, schema="cellapp-rehearsals"):
    """The file of a profile's rehearsals: the newest result of each rung; ``arms`` is the hash of its arms."""

    arms: str
    rungs: Mapping[RungName, RehearseResult]


_STORED = "rehearsals"
"""Name of the stored copy in a run."""


def arms_hash(profile: Profile) -> str:
    """Return the hash of what a rehearsal depends on: arms, their bases and obstacles."""
    text = profile.model_dump_json(by_alias=True, include={"arms", "obstacles"})
    return hashlib.sha256(text.encode()).hexdigest()


def read_log(path: Path, profile: Profile) -> RehearsalLog:
    """Return the recorded rungs of these arms; none without a file or if it is of other arms. Raises ``InputError``."""
    new = RehearsalLog(arms=arms_hash(profile), rungs={})
    file = rehearsals_path(path)
    if not file.is_file():
        return new
    found = RehearsalLog.from_json(file_text(file, "move it away and rehearse again"), str(file))
    return found if found.arms == new.arms else new


def write_log(path: Path, log: RehearsalLog) -> None:
    """Write the file beside the profile."""
    RENEWED.write_text(rehearsals_path(path), log.to_json(indent=1) + "\n")


def missing_rungs(log: RehearsalLog) -> tuple[RungName, ...]:
    """Return the rungs that were not passed yet, in their order."""
    return tuple(name for name in RUNGS if name not in log.rungs or not log.rungs[name].passed)


def keep_log(run: RunFile) -> str:
    """Copy the record of rungs into a run when it is collected: the file beside the profile changes later.

    Returns a sentence on the rungs that a run of real arms lacks; empty if none is missing, and for other runs.
    """
    path = noted_profile(run)
    try:
        log = None if path is None else read_log(path, run.profile)
    except InputError as error:
        return str(error) if run.profile.moves_hardware else ""
    if log is not None and log.rungs:
        run.write_document(_STORED, log.to_json())
    missing = tuple(RUNGS) if log is None else missing_rungs(log)
    if not missing or not run.profile.moves_hardware:
        return ""
    return f"not rehearsed with these arms: {', '.join(missing)}; 'cellapp rehearse PROFILE' does the next one"


def kept_log(run: RunFile) -> RehearsalLog | None:
    """Return the record of rungs from when the run was collected; None without one."""
    text = run.read_document(_STORED)
    return None if text is None else RehearsalLog.from_json(text, "the run's rehearsals")
