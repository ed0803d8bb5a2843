"""The result of ``import`` as sentences."""

from __future__ import annotations

from cellapp.cell.driving.records import ImportResult
from cellapp.commands.record import Request, View
from cellapp.ground.counting import counted


def view(result: ImportResult, request: Request | None = None) -> View:
    """How many readings each arm has, and what was noticed."""
    return View(
        (*(f"arm {name}: {counted(count, 'reading')}" for name, count in result.readings.items()), *result.notes),
        held="; ".join(result.notes),
    )
