"""The verb ``report``: the page of a run."""

from __future__ import annotations

from cellapp.cell.run import RunFile
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.commands.record import Work
from cellapp.commands.report.request import ReportRequest
from cellapp.commands.run_results import ReportResult, read_results, shown_by
from cellapp.ground.outputs import RENEWED


def run(request: ReportRequest, work: Work) -> ReportResult:
    """Write the page. Raises ``InputError`` if the run is not calibrated yet."""
    with RunFile.open(request.folder) as opened:
        RENEWED.check(request.folder / REPORT_FILE)
        return shown_by(ReportResult, read_results(opened), page=str(work.write_page(opened)))
