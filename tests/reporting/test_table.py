"""Tables: numbers in cells, one formatter for all that draw them."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from cellapp.reporting.table import Cell, Column, Interval, Number, Table, format_cell, number_column
from cellapp.reporting.terminal import rich_table

pytestmark = pytest.mark.fast

TABLE = Table(
    "Errors [mm]",
    (Column("stage"), number_column("mean", ".4f", "mm"), number_column("n", "d"), Column("note")),
    (("nominal", 0.12345, 17, "[bold]"), ("effects", Interval(0.1, 0.25), None, None)),
)


@pytest.mark.parametrize(
    ("cell", "number_format", "text"),
    [
        (None, ".4f", ""),
        ("none", ".4f", "none"),
        (3, "d", "3"),
        (0.00497, ".2g", "0.005"),
        (-0.5, "+.5f", "-0.50000"),
        (Interval(0.1, 0.25), ".4f", "0.1000 to 0.2500"),
        (Interval(9, 37), "d", "9 to 37"),
        (Interval(16.6327, 16.7033, 3), ".4f", "16.633 to 16.703"),
        (Number(27.69, 1, "%"), ".4f", "27.7 %"),
        (Number(42.91, 1), "", "42.9"),
    ],
)
def test_cells_are_formatted_by_their_column(cell: Cell, number_format: str, text: str) -> None:
    assert format_cell(cell, number_format) == text


def test_headings_have_units_and_rows_are_text() -> None:
    assert TABLE.headings == ("stage", "mean [mm]", "n", "note")
    assert TABLE.text_rows() == (("nominal", "0.1235", "17", "[bold]"), ("effects", "0.1000 to 0.2500", "", ""))


def test_a_row_needs_a_cell_for_each_column() -> None:
    with pytest.raises(ValueError, match="1 cells in a row of 2 columns"):
        Table("t", (Column("a"), Column("b")), (("only",),))


def test_a_terminal_shows_brackets_as_text_and_aligns_numbers_right() -> None:
    output = io.StringIO()
    Console(file=output, width=80).print(rich_table(TABLE))
    text = output.getvalue()
    assert "Errors [mm]" in text
    assert "[bold]" in text
    first, second = (line for line in text.splitlines() if line.strip().startswith(("nominal", "effects")))
    assert first.index("0.1235") + len("0.1235") == second.index("0.2500") + len("0.2500")
