"""What a person reads when a job ended."""

from __future__ import annotations

import os
import shlex
import traceback
from dataclasses import dataclass
from pathlib import Path

from cellapp.control import Aborted
from cellapp.errors import CellappError, HardwareError
from cellapp.progress import Cancelled, Progress
from cellapp.tui.jobs import JobEnded

ERROR_LOG = "error.log"
STOPPED = 4
UNEXPECTED = 3
"""Exit codes: stopped and resumable; an unexpected error, after which somebody must look at the cell."""

_RESUMED_BY = {"plan": "", "collect": "--resume", "push": "TARGETS --verify"}
"""What follows ``cellapp JOB DIR`` to go on; a plan that was not finished leaves nothing."""


@dataclass(frozen=True)
class Ending:
    """How a job ended: a sentence, how serious it is, the exit code of the program that quits then."""

    text: str
    severity: str
    code: int


def ending_of(ended: JobEnded, last: Progress | None) -> Ending:
    """The end of a job in words; ``last`` is its newest event."""
    name, folder, ending = ended.job.name, ended.job.folder, ended.ending
    if not isinstance(ending, BaseException):
        return Ending(f"{name}: done" + ("" if folder is None else f"; the run is in {folder}") + ".", "information", 0)
    resume = how_to_resume(last, folder)
    if isinstance(ending, Cancelled):
        word = "Aborted" if isinstance(ending, Aborted) else "Stopped"
        return Ending(f"{word}; {resume}." if resume else f"{word}; nothing is left to resume.", "warning", STOPPED)
    if isinstance(ending, CellappError):
        more = f"; then {resume}." if resume and isinstance(ending, HardwareError) else ""
        return Ending(f"{ending}{more}", "error", ending.exit_code)
    return Ending(_unexpected(ending, folder), "error", UNEXPECTED)


def how_to_resume(last: Progress | None, folder: Path | None) -> str:
    """How to go on after a job that ended after the event ``last``; empty if there is nothing to resume."""
    if last is None or folder is None or last.job == "replay" or (last.job == "plan" and last.done < last.total):
        return ""
    job = last.job if last.job in ("calibrate", "discover", "push") else "collect"
    command = f"cellapp {job} {shlex.quote(str(folder))} {_RESUMED_BY.get(job, '')}".rstrip()
    return f"go on here with the key of that step, or with: {command}"


def _unexpected(error: BaseException, folder: Path | None) -> str:
    """Write the traceback of an unexpected error into the run's folder and return one sentence about it."""
    what = f"Unexpected {type(error).__name__} in the program"
    path = (folder or Path()) / ERROR_LOG
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(traceback.format_exception(error)), encoding="utf-8")
    except OSError as failure:
        return f"{what}: {error}. Its traceback could not be written to {path}: {failure.strerror}."
    return f"{what}; its traceback is in {path}. Measured data are kept."


def forget_terminal() -> None:
    """Let drawing go nowhere: the terminal was closed, and a write to it would fail."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    os.close(nowhere)
