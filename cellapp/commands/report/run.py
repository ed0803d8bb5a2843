"""The verb ``report``: the page of a run, and a print of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.commands.record import Work
from cellapp.commands.report.request import PDF_FILE, ReportRequest
from cellapp.commands.report.result import ReportResult, read_results, shown_by
from cellapp.ground.chromium import print_pdf
from cellapp.ground.outputs import RENEWED, Outputs

PageWriter = Callable[[RunFile], Path]
"""Writes the page of a run into its folder and returns the page's path."""


def run(request: ReportRequest, work: Work) -> ReportResult:
    """Write the page; replace the usual PDF, treat one with its own path like any other output file."""
    printed_to = (request.out or request.folder / PDF_FILE) if request.pdf else None
    with RunFile.open(request.folder) as opened:
        return report_run(opened, work.write_page, printed_to, RENEWED if request.out is None else work.outputs)


def report_run(
    run: RunFile, write_page: PageWriter, pdf: Path | None = None, outputs: Outputs = RENEWED
) -> ReportResult:
    """Write the page of a run and, with ``pdf``, print it to that file.

    ``outputs`` says what the PDF may replace; by default an earlier print.

    Raises
    ------
    InputError
        If the run is not calibrated yet, or the page was written but cannot be printed.
    """
    page = write_page(run)
    if pdf is not None:
        print_pdf(page, pdf, outputs=outputs)
    return shown_by(ReportResult, read_results(run), page=str(page), pdf=None if pdf is None else str(pdf))
