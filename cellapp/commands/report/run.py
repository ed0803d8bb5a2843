"""The verb ``report``: the page of a run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.commands.record import Work
from cellapp.commands.report.request import ReportRequest
from cellapp.commands.report.result import ReportResult, shown_by
from cellapp.commands.run_results import read_results

PageWriter = Callable[[RunFile], Path]
"""Writes the page of a run into its folder and returns the page's path."""


def run(request: ReportRequest, work: Work) -> ReportResult:
    """Write the page."""
    with RunFile.open(request.folder) as opened:
        return report_run(opened, work.write_page)


def report_run(run: RunFile, write_page: PageWriter) -> ReportResult:
    """Write the page of a run. Raises ``InputError`` if the run is not calibrated yet."""
    return shown_by(ReportResult, read_results(run), page=str(write_page(run)))
