"""Result of the verb ``run``."""

from __future__ import annotations

from cellapp.cell.driving.records import CollectResult
from cellapp.commands.run_results import RunResults


class WholeRunResult(RunResults, schema="cellapp-run"):
    """``run``: the folder, the results of every step, and notes for the operator."""

    collect: CollectResult | None = None
    notes: tuple[str, ...] = ()
