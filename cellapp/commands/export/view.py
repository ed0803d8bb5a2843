"""The result of ``export`` as sentences."""

from __future__ import annotations

from cellapp.cell.exports.formats import export_lines
from cellapp.cell.exports.records import ExportResult
from cellapp.commands.record import Request, View


def view(result: ExportResult, request: Request | None = None) -> View:
    """Show the written files, and what they do not represent."""
    return View(tuple(export_lines(result)))
