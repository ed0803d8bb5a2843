"""What the tables of a test by ISO 9283 share."""

from __future__ import annotations

from collections.abc import Iterator

from cellapp.commands.view.table import Cell, Column, number_column
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, IsoCommands
from cellapp.estimation.iso9283.records import CommandedTests, Iso9283Result, IsoValue, SpeedSeries


def tests_of(result: Iso9283Result) -> Iterator[tuple[str, IsoCommands, CommandedTests]]:
    """Arm, commands and what was measured with them."""
    for name, arm in result.arms.items():
        for kind in ISO_COMMANDS:
            if kind in arm.tests:
                yield name, kind, arm.tests[kind]


def series_of(result: Iso9283Result) -> Iterator[tuple[str, IsoCommands, SpeedSeries]]:
    """Arm, commands and the tests that were repeated at another speed."""
    for name, kind, tests in tests_of(result):
        for one in tests.series:
            yield name, kind, one


def pair_columns(first: str, second: str) -> tuple[Column, ...]:
    """A column for each of two characteristics and its uncertainty."""
    return tuple(number_column(title, ".3f") for name in (first, second) for title in (name, f"U({name})"))


def value_cells(value: IsoValue) -> tuple[Cell, Cell]:
    """A characteristic and its uncertainty."""
    return value.value_mm, value.expanded_mm
