"""Result of ``run``."""

from __future__ import annotations

from typing import Literal

from cellapp.cell.driving.records import CollectResult
from cellapp.commands.report.result import RunResults


class WholeRunResult(RunResults):
    """``run``: the folder, the results of every step, and notes for the operator."""

    schema_: Literal["cellapp-run"] = "cellapp-run"
    version: Literal[1] = 1
    collect: CollectResult | None = None
    notes: tuple[str, ...] = ()
