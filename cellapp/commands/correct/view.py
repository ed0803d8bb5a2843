"""Corrected targets of a program, as a table and sentences."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.cell.programs.records import CorrectedTarget, CorrectResult
from cellapp.cell.programs.solving import correct_lines, refusal
from cellapp.commands.record import Request, View
from cellapp.commands.view.table import Cell, Column, Table, number_column


def view(result: CorrectResult, request: Request | None = None) -> View:
    """Show every target, the assumptions, and what could not be corrected."""
    return View((correct_table(result), *correct_lines(result)), refused=refusal(result))


def correct_table(result: CorrectResult) -> Table:
    """Show each target's old and new numbers in two rows, with size and uncertainty of the correction.

    Below the motion stands the configuration nearest to its solution.
    """
    columns = (
        Column("line"),
        Column("motion"),
        Column("target (m, rad)"),
        number_column("moves", ".3f", "mm"),
        number_column("turns", ".3f", "mrad"),
        number_column("sigma", ".3f", "mm"),
    )
    rows = tuple(row for target in result.targets for row in _rows(target))
    return Table(f"Targets of {result.program}", columns, rows)


def _rows(target: CorrectedTarget) -> list[tuple[Cell, ...]]:
    old: tuple[Cell, ...] = (str(target.line), target.command, _numbers(target.old), None, None, None)
    if target.new is None:
        return [old, ("", "", "not corrected, see below", None, None, None)]
    sizes = (target.correction_mm, target.correction_mrad, target.uncertainty_mm)
    return [old, ("", target.nearest_to, _numbers(target.new), *sizes)]


def _numbers(values: Sequence[float]) -> str:
    return ",".join(f"{value:.3f}" for value in values)  # without spaces: a narrow terminal would break lines there
