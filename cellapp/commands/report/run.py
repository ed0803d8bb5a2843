"""The verb ``report``: the page of a run.

The result of ``report`` as tables and sentences.
"""

from __future__ import annotations

from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.commands.calibrate.view import calibration_tables
from cellapp.commands.check.view import location_tables
from cellapp.commands.compensate.tables import verification_tables
from cellapp.commands.discover.tables import discovery_tables
from cellapp.commands.record import Request, View, Work
from cellapp.commands.report.request import ReportRequest
from cellapp.commands.run_results import ReportResult, RunResults, read_results, shown_by
from cellapp.commands.stages import complaints_in
from cellapp.commands.view.table import Table
from cellapp.ground.outputs import RENEWED


def run(request: ReportRequest, work: Work) -> ReportResult:
    """Write the page. Raises ``InputError`` if the run is not calibrated yet."""
    with RunFile.open(request.folder) as opened:
        RENEWED.check(request.folder / REPORT_FILE)
        return shown_by(ReportResult, read_results(opened), page=str(work.write_page(opened)))


def view(result: ReportResult, request: Request | None = None) -> View:
    """Show the results that the page shows, what is out of date, and where the page was written."""
    strict = isinstance(request, ReportRequest) and request.strict
    return View([*result_parts(result), f"written: {result.page}"], complaints_in(Path(result.run)) if strict else ())


# -- Results of a run for a terminal: tables, and what is out of date -------------------------------------------------


def result_parts(results: RunResults) -> list[Table | str]:
    """Show calibration, discovery, location and verification; say why those that are out of date no longer hold."""
    tables: list[Table] = []
    if results.calibrate is not None:
        tables += calibration_tables(results.calibrate)
    held = results.held
    if held.discover is not None:
        tables += discovery_tables(held.discover)
    if held.locate is not None:
        tables += location_tables(held.locate)
    if held.verify is not None:
        tables += verification_tables(held.verify)
    return [*tables, *(f"out of date: {name}: {reason}" for name, reason in results.out_of_date.items())]
