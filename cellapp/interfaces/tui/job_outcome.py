"""Words for a person about how a job ended."""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.commands.record import View
from cellapp.commands.run.request import VERB as RUN
from cellapp.ground.control import Aborted
from cellapp.ground.errors import CellappError, CheckFailed, HardwareError, InputError
from cellapp.ground.outputs import RENEWED
from cellapp.ground.progress import Cancelled, Progress
from cellapp.interfaces.tui.host import Severity
from cellapp.interfaces.tui.jobs import Job
from cellapp.interfaces.tui.keys import way_to
from cellapp.interfaces.tui.leaving import STOPPED
from cellapp.interfaces.tui.live_run import Detached

if TYPE_CHECKING:
    from cellapp.ground.results import Result

ERROR_LOG = "error.log"
REPORT_FILE = "report.html"
"""Same name as in ``cellapp.cell.run.sqlite_file``, whose import would slow down the start."""
UNEXPECTED = 3
"""Exit code of an unexpected error, after which somebody must look at the cell."""

_RESUMABLE = ("collect", "calibrate", "discover", "push", "verify")
"""Jobs that continue where they were, or can be repeated without loss."""
_PLANS = ("plan", "compare")
"""Last events of planning, random and designed; an unfinished plan is not stored."""


Ending = tuple[str, Severity, int]
"""End of a job: a sentence, its severity, and the exit code of the program if it quits then."""


def ending_of(job: Job, ending: Result | BaseException | None, view: View, last: Progress | None) -> Ending:
    """Return the end of a job in words; ``last`` is its newest event."""
    folder = job.folder
    if not isinstance(ending, BaseException):
        return _done(job, view)
    if isinstance(ending, Detached):
        goes_on = f"'{job.name}' goes on in process {job.process}"
        return (f"{goes_on}. Open {folder} again to stop it.", "information", 0)
    resume = how_to_resume(last, folder)
    if isinstance(ending, Cancelled):
        word = "Aborted" if isinstance(ending, Aborted) else "Stopped"
        return (f"{word}; {resume}." if resume else f"{word}; nothing is left to resume.", "warning", STOPPED)
    if isinstance(ending, CellappError):
        more = f"; then {resume}." if resume and isinstance(ending, HardwareError) else ""
        return (f"{ending}{more}", "error", ending.exit_code)
    return (_unexpected(ending, folder), "error", UNEXPECTED)


def _done(job: Job, view: View) -> Ending:
    """Return the end of a completed job; if a check did not hold, with the exit code of the command."""
    where = "" if job.folder is None else f"; the run is in {job.folder}"
    if job.process is not None:
        return (f"{job.name}: process {job.process} has ended it{where}.", "information", 0)
    if job.folder is not None and job.name == RUN.name:
        where = f"; the report is {job.folder / REPORT_FILE}"
    if view.refused:
        return (f"{job.name}: {view.refused}{where}.", "error", InputError.exit_code)
    if view.failed:
        checks = view.checks or (job.verb.checks if job.verb is not None else "")
        what = "" if checks in ("", job.name) else f"{checks}: "
        return (f"{job.name}: {what}{'; '.join(view.failed).rstrip('.')}{where}.", "error", CheckFailed.exit_code)
    held = f"; {view.held.rstrip('.')}" if view.held else ""
    return (f"{job.name}: done{held}{where}.", "information", 0)


def how_to_resume(last: Progress | None, folder: Path | None) -> str:
    """Return how to continue after a job whose last event was ``last``; empty if there is nothing to resume."""
    if last is None or folder is None:
        return ""
    job = "collect" if last.job in _PLANS and last.done >= last.total else last.job
    return f"{way_to('push' if job == 'verify' else job)} go on" if job in _RESUMABLE else ""


def left_behind(name: str, patience_s: float) -> str:
    """Return what a person must know about a job that did not stop before the program ended."""
    return (
        f"'{name}' did not stop within {patience_s:.0f} s; cellapp ended without it. Check the cell before you start"
        " again; the run keeps the measured data."
    )


def _unexpected(error: BaseException, folder: Path | None) -> str:
    """Write the traceback of an unexpected error into the run's folder and return one sentence about it."""
    what = f"Unexpected {type(error).__name__} in the program"
    path = (folder or Path()) / ERROR_LOG
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        RENEWED.write_text(path, "".join(traceback.format_exception(error)))
    except (OSError, CellappError) as failure:
        return f"{what}: {error}. Its traceback could not be written to {path}: {failure}."
    return f"{what}; its traceback is in {path}. Measured data are kept."
