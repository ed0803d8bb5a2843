"""The result of ``export`` as sentences."""

from __future__ import annotations

from cellapp.cell.exports.records import ExportResult
from cellapp.cell.exports.words import export_lines
from cellapp.commands.record import Request, View


def view(result: ExportResult, request: Request | None = None) -> View:
    """Show the files that were written, and what they do not hold."""
    return View(tuple(export_lines(result)))
