"""What a compensation says."""

from __future__ import annotations

from cellapp.cell.targets.records import CompensateResult
from cellapp.commands.compensate.tables import stored_tables
from cellapp.commands.compensate.words import compensate_lines
from cellapp.commands.view.table import View


def compensation_view(result: CompensateResult) -> View:
    """What ``show DIR targets`` prints: commands, uncertainties, predictions, and what must be known of them."""
    return [*stored_tables(result), *compensate_lines(result)]
