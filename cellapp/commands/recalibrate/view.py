"""Table and sentences of ``recalibrate``."""

from __future__ import annotations

from cellapp.commands.recalibrate.result import RecalibrateResult
from cellapp.commands.record import Request, View
from cellapp.commands.view.table import Table, table_of
from cellapp.ground.counting import counted


def view(result: RecalibrateResult, request: Request | None = None) -> View:
    """Show what was recomputed, and which runs failed."""
    tables = [recalibration_table(result)] if result.made else []
    failed = f"{len(result.failed)} of {counted(len(result.failed) + len(result.runs), 'run')} failed"
    return View((*tables, *recalibration_sentences(result)), (failed,) if result.failed else ())


def recalibration_table(result: RecalibrateResult) -> Table:
    """Show the recomputed runs."""
    return table_of(
        "Runs calibrated again",
        result.made,
        ("run", "run"),
        ("made again", lambda run: ", ".join(run.made)),
        ("because", "because"),
        ("mean held-out error [mm]", lambda run: ", ".join(f"{arm} {x:.3f}" for arm, x in run.heldout_mm.items())),
        ("time", "seconds", ".1f", "s"),
    )


def recalibration_sentences(result: RecalibrateResult) -> list[str]:
    """State how many runs were recomputed, up to date and failed; which runs failed and why."""
    held = len(result.runs) - len(result.made)
    counts = f"{counted(len(result.made), 'run')} computed again, {held} up to date, {len(result.failed)} failed"
    return [counts, *(f"{run}: {why}" for run, why in result.failed.items())]
