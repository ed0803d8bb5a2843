"""What a person reads when a job ended."""

from __future__ import annotations

import os
import shlex
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.cell.driving.requests.attaching import Detached
from cellapp.ground.control import Aborted
from cellapp.ground.errors import CellappError, CheckFailed, HardwareError
from cellapp.ground.outputs import RENEWED
from cellapp.ground.progress import Cancelled, Progress
from cellapp.interfaces.tui.jobs import Job, JobEnded
from cellapp.interfaces.tui.messages import Severity
from cellapp.interfaces.tui.work import VERIFY

if TYPE_CHECKING:
    from cellapp.ground.results import Result

ERROR_LOG = "error.log"
REPORT_FILE = "report.html"
"""As ``cellapp.cell.run.sqlite_file`` names it, which loads more than a start needs."""
STOPPED = 4
UNEXPECTED = 3
"""Exit codes: stopped and resumable; an unexpected error, after which somebody must look at the cell."""

_RESUMED_BY = {"collect": "--resume", "calibrate": "", "discover": "", "push": "TARGETS --verify"}
"""What follows ``cellapp JOB DIR`` to go on."""
_PLANS = ("plan", "compare")
"""The last events of planning, random and designed; a plan that was not finished leaves nothing."""


@dataclass(frozen=True)
class Ending:
    """How a job ended: a sentence, how serious it is, the exit code of the program that quits then."""

    text: str
    severity: Severity
    code: int


def ending_of(ended: JobEnded, last: Progress | None) -> Ending:
    """The end of a job in words; ``last`` is its newest event."""
    folder, ending = ended.job.folder, ended.ending
    if not isinstance(ending, BaseException):
        return _done(ended.job, ending)
    if isinstance(ending, Detached):
        goes_on = f"'{ended.job.name}' goes on in process {ended.job.process}"
        return Ending(f"Detached; {goes_on}. 'cellapp stop {folder}' stops it.", "information", 0)
    resume = how_to_resume(last, folder)
    if isinstance(ending, Cancelled):
        word = "Aborted" if isinstance(ending, Aborted) else "Stopped"
        return Ending(f"{word}; {resume}." if resume else f"{word}; nothing is left to resume.", "warning", STOPPED)
    if isinstance(ending, CellappError):
        more = f"; then {resume}." if resume and isinstance(ending, HardwareError) else ""
        return Ending(f"{ending}{more}", "error", ending.exit_code)
    return Ending(_unexpected(ending, folder), "error", UNEXPECTED)


def _done(job: Job, result: Result | None) -> Ending:
    """The end of a job that did all it was to do; with the exit code of the command where a check did not hold."""
    from cellapp.commands.run.result import WholeRunResult

    where = "" if job.folder is None else f"; the run is in {job.folder}"
    complaints, held = _checks(result, verifies=job.name == VERIFY)
    if job.folder is not None and isinstance(result, WholeRunResult):
        where = f"; the report is {job.folder / REPORT_FILE}"
    if complaints:
        return Ending(f"{job.name}: {'; '.join(complaints)}{where}.", "error", CheckFailed.exit_code)
    return Ending(f"{job.name}: done{held}{where}.", "information", 0)


def _checks(result: Result | None, *, verifies: bool) -> tuple[list[str], str]:
    """What did not hold, and what is said of the verification or of a plan if all did."""
    from cellapp.cell.driving.records import CollectResult, ImportResult, PlanResult
    from cellapp.cell.targets.path_records import PathResult
    from cellapp.cell.targets.records import VerifyResult
    from cellapp.commands.certificate.result import CertificateResult
    from cellapp.commands.check_certificate.result import CertificateCheckResult
    from cellapp.commands.locate.result import LocateResult
    from cellapp.commands.run.result import WholeRunResult
    from cellapp.estimation.iso9283.records import Iso9283Result
    from cellapp.estimation.monitoring.check.records import CheckResult

    if isinstance(result, PlanResult | ImportResult):
        return [], "".join(f"; {note}" for note in result.notes)
    if isinstance(result, PathResult | Iso9283Result):
        return result.complaints(), ""
    if isinstance(result, CheckResult):
        return result.complaints(), "; the calibration holds"
    if isinstance(result, CertificateResult):
        doubts = "; it does not confirm conformity" if result.complaints() else ""
        return [], f"; certificate {result.number} was written{doubts}"
    if isinstance(result, CertificateCheckResult):
        return result.complaints(), f"; signature {result.signature}"
    collected = result if isinstance(result, CollectResult) else None
    verified = result if verifies and isinstance(result, VerifyResult) else None
    is_day = isinstance(result, WholeRunResult)
    if isinstance(result, WholeRunResult):
        collected, verified = result.collect, result.verify
    missing = [] if collected is None else collected.complaints()
    wrong = [] if verified is None else verified.complaints()
    if isinstance(result, LocateResult):
        return [f"location: {text}" for text in result.complaints()], "; the tracker was located"
    unverified = "; nothing was verified, the profile names no targets" if is_day else ""
    held = unverified if verified is None else "; the verification held"
    return [*missing, *(f"verification: {text}" for text in wrong)], held


def how_to_resume(last: Progress | None, folder: Path | None) -> str:
    """How to go on after a job that ended after the event ``last``; empty if there is nothing to resume."""
    if last is None or folder is None:
        return ""
    job = "collect" if last.job in _PLANS and last.done >= last.total else last.job
    if job not in _RESUMED_BY:
        return ""
    command = f"cellapp {job} {shlex.quote(str(folder))} {_RESUMED_BY.get(job, '')}".rstrip()
    return f"go on here with the key of that step, or with: {command}"


def left_behind(name: str, patience_s: float) -> str:
    """What a person must know of a job that did not stop before the program ended."""
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


def forget_terminal() -> None:
    """Let drawing go nowhere: the terminal was closed, and a write to it would fail."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    os.close(nowhere)
