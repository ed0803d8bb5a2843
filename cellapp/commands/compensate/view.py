"""The result of ``compensate`` as tables and sentences."""

from __future__ import annotations

from cellapp.cell.targets.records import CompensateResult
from cellapp.commands.compensate.charts import parts_charts
from cellapp.commands.compensate.tables import predicted_tables, stored_tables
from cellapp.commands.compensate.words import compensate_lines
from cellapp.commands.record import Request, View


def view(result: CompensateResult, request: Request | None = None) -> View:
    """Show what is expected at the targets, and the uncertainty's sources; of a stored result also the commands."""
    tables = stored_tables(result) if request is None else predicted_tables(result)
    return View((*tables, *compensate_lines(result), *parts_charts(result)))
