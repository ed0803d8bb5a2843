"""The result of ``replay`` as sentences."""

from __future__ import annotations

from cellapp.cell.driving.records import ReplayResult
from cellapp.commands.record import Request, View
from cellapp.ground.counting import counted


def view(result: ReplayResult, request: Request | None = None) -> View:
    """Show what was played back, and how fast."""
    counts = ", ".join(f"{name} {count}" for name, count in result.readings.items())
    pace = "recorded in" if result.timed else "without times, at a fixed pace"
    return View(
        (
            f"{counted(result.stops, 'stop')} played back, readings: {counts}",
            f"{pace} {result.duration_s / 60.0:.1f} min, played {result.speed:g} times as fast",
        )
    )
