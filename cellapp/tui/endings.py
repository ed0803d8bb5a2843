"""What a person reads when a run ended early."""

from __future__ import annotations

import shlex
import traceback
from pathlib import Path

from cellapp.progress import Progress

ERROR_LOG = "error.log"

_RESUME_COMMANDS = {
    "collect": "cellapp collect {} --resume",
    "calibrate": "cellapp calibrate {}",
    "discover": "cellapp discover {}",
    "push": "cellapp push {} TARGETS --verify",
}


def how_to_resume(last: Progress | None, folder: Path) -> str:
    """The command that resumes a run which ended after the event ``last``; empty if there is nothing to resume."""
    if last is None or (last.job == "plan" and last.done < last.total):
        return ""
    command = _RESUME_COMMANDS.get(last.job, _RESUME_COMMANDS["collect"])
    return "continue with: " + command.format(shlex.quote(str(folder)))


def write_error_log(error: BaseException, folder: Path) -> str:
    """Write the traceback of an unexpected error into the run's folder and return one sentence about it."""
    what = f"Unexpected {type(error).__name__} in the program"
    path = folder / ERROR_LOG
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(traceback.format_exception(error)), encoding="utf-8")
    except OSError as failure:
        return f"{what}: {error}. Its traceback could not be written to {path}: {failure.strerror}."
    return f"{what}; its traceback is in {path}. Measured data are kept."
