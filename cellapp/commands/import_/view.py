"""The result of ``import`` as sentences."""

from __future__ import annotations

from cellapp.cell.driving.records import ImportResult
from cellapp.commands.record import Request, View
from cellapp.commands.view.recordings import recording_tables
from cellapp.ground.counting import counted


def view(result: ImportResult, request: Request | None = None) -> View:
    """Show the number of readings and the recordings of each arm, and notes."""
    counts = (f"arm {name}: {counted(count, 'reading')}" for name, count in result.readings.items())
    return View((*counts, *recording_tables(result.recordings), *result.notes), held="; ".join(result.notes))
