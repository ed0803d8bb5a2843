"""The result of ``report`` as tables and sentences."""

from __future__ import annotations

from pathlib import Path

from cellapp.commands.out_of_date import complaints_in
from cellapp.commands.record import Request, View
from cellapp.commands.report.request import ReportRequest
from cellapp.commands.report.result import ReportResult
from cellapp.commands.report.tables import all_tables, out_of_date_sentences


def view(result: ReportResult, request: Request | None = None) -> View:
    """Show the results that the page shows, what is out of date, and where the page was written."""
    printed = () if result.pdf is None else (f"printed: {result.pdf}",)
    parts = (*all_tables(result), *out_of_date_sentences(result), f"written: {result.page}", *printed)
    strict = isinstance(request, ReportRequest) and request.strict
    return View(parts, complaints_in(Path(result.run)) if strict else ())
