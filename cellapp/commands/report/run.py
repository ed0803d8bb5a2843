"""The verb ``report``: the page of a run."""

from __future__ import annotations

from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.commands.record import View, Work
from cellapp.commands.report.request import ReportRequest
from cellapp.commands.run_results import ReportResult, read_results, shown_by
from cellapp.commands.run_state import complaints_in
from cellapp.ground.outputs import RENEWED


def run(request: ReportRequest, work: Work) -> ReportResult:
    """Write the page. Raises ``InputError`` if the run is not calibrated yet."""
    with RunFile.open(request.folder) as opened:
        RENEWED.check(request.folder / REPORT_FILE)
        return shown_by(ReportResult, read_results(opened), page=str(work.write_page(opened)))


def view(result: ReportResult, request: ReportRequest | None = None) -> View:
    """Say what is out of date, and where the page with all results was written."""
    strict = request is not None and request.strict
    outdated = (f"out of date: {name}: {reason}" for name, reason in result.out_of_date.items())
    return View((*outdated, f"written: {result.page}"), complaints_in(Path(result.run)) if strict else ())
