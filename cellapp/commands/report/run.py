"""The verb ``report``: the page of a run, and a print of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.commands.report.result import ReportResult, read_results, shown_by
from cellapp.ground.chromium import print_pdf
from cellapp.ground.outputs import RENEWED, Outputs

PageWriter = Callable[[RunFile], Path]
"""Writes the page of a run into its folder and returns the page's path."""


def report_run(
    run: RunFile, write_page: PageWriter, pdf: Path | None = None, outputs: Outputs = RENEWED
) -> ReportResult:
    """Write the page of a run and, with ``pdf``, print it to that file.

    ``outputs`` says what the PDF may replace: left out, an earlier print.

    Raises
    ------
    InputError
        If the run is not calibrated yet, or the page was written but cannot be printed.
    """
    page = write_page(run)
    if pdf is not None:
        print_pdf(page, pdf, outputs=outputs)
    return shown_by(ReportResult, read_results(run), page=str(page), pdf=None if pdf is None else str(pdf))
