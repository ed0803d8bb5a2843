"""What is said of a job that is done: the report of a day, whether its verification held, the command's exit code."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.run import sqlite_file
from cellapp.cell.targets.records import ArmVerification, MeasuredTarget, VerifyResult
from cellapp.commands.run.request import VERB as DAY
from cellapp.commands.run.run import WholeRunResult
from cellapp.ground.results import ErrorSummary, Result
from cellapp.interfaces.tui import work
from cellapp.interfaces.tui.endings import REPORT_FILE, ending_of
from cellapp.interfaces.tui.jobs import Job, JobEnded

RUN = Path("logs/monday")
SMALL_MM, LARGE_MM = (ErrorSummary(mean=mm, rms=mm, std=0.0, max=mm, n=3) for mm in (0.1, 2.0))
TARGETS = (MeasuredTarget(name="t1", arm="left", nominal_mm=None, compensated_mm=None, note=""),)
HELD = VerifyResult(arms={"left": ArmVerification(nominal_mm=LARGE_MM, compensated_mm=SMALL_MM)}, targets=TARGETS)
WORSE = VerifyResult(arms={"left": ArmVerification(nominal_mm=SMALL_MM, compensated_mm=LARGE_MM)}, targets=TARGETS)


def ended(job: Job, result: Result | None) -> tuple[str, int]:
    ending = ending_of(JobEnded(job, result, None if result is None else job.view(result)), None)
    return ending.text, ending.code


@pytest.mark.parametrize(
    ("verify", "words", "code"),
    [(HELD, "the verification held", 0), (None, "nothing was verified", 0), (WORSE, "verification: arm left", 1)],
)
def test_a_day_names_its_report_and_says_whether_the_verification_held(
    verify: VerifyResult | None, words: str, code: int
) -> None:
    text, exit_code = ended(work.job_of(DAY, profile=RUN, folder=RUN), WholeRunResult(run=str(RUN), verify=verify))
    assert words in text
    assert str(RUN / "report.html") in text
    assert exit_code == code


def test_the_page_is_named_as_it_is_written() -> None:
    """The module has a copy of the name: the run's own loads scipy, which a start need not wait for."""
    assert REPORT_FILE == sqlite_file.REPORT_FILE
