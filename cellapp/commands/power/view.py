"""Sizes from which effects are named, as sentence, table and chart."""

from __future__ import annotations

from cellapp.commands.record import Request, View
from cellapp.commands.trials.power.result import PowerResult
from cellapp.commands.trials.power.tables import power_parts


def view(result: PowerResult, request: Request | None = None) -> View:
    """Build a sentence, and a chart and a table for each arm."""
    return View(power_parts(result))
