"""The targets of a program that was corrected, as a table."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.reporting.table import Column, Number, Table, number_column
from cellapp.results import CorrectResult


def correct_table(result: CorrectResult) -> Table:
    """One row for each target: old and new numbers, the size of its correction, its uncertainty."""
    rows = tuple(
        (
            one.line,
            one.command,
            _numbers(one.old),
            "" if one.new is None else _numbers(one.new),
            _number(one.correction_mm, 3),
            _number(one.correction_mrad, 3),
            _number(one.uncertainty_mm, 3),
            one.reason or (f"nearest to {one.nearest_to}" if one.nearest_to else ""),
        )
        for one in result.targets
    )
    columns = (
        number_column("line", "d"),
        Column("motion"),
        Column("old (m, rad)"),
        Column("new (m, rad)"),
        number_column("moves", ".3f", "mm"),
        number_column("turns", ".3f", "mrad"),
        number_column("uncertainty", ".3f", "mm"),
        Column("remark"),
    )
    return Table(f"Targets of {result.program}", columns, rows)


def _number(value: float | None, decimals: int) -> Number | None:
    return None if value is None else Number(value, decimals)


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.6f}" for value in values)
