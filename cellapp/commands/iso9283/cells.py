"""Shared parts of the tables of a test by ISO 9283."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from cellapp.commands.view.table import Cell, Column, Field, number_column
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, IsoCommands
from cellapp.estimation.iso9283.records import CommandedTests, Iso9283Result, IsoValue, SpeedSeries
from cellapp.ground.results import Record


def tests_of(result: Iso9283Result) -> Iterator[tuple[str, IsoCommands, CommandedTests]]:
    """Yield arm, commands and the tests with these commands."""
    for name, arm in result.arms.items():
        for kind in ISO_COMMANDS:
            if kind in arm.tests:
                yield name, kind, arm.tests[kind]


def series_of(result: Iso9283Result) -> Iterator[tuple[str, IsoCommands, SpeedSeries]]:
    """Yield arm, commands and the tests repeated at another speed."""
    for name, kind, tests in tests_of(result):
        for one in tests.series:
            yield name, kind, one


class Commanded(NamedTuple):
    """A measurement of an arm with one kind of commands; ``of`` is what it is part of, as a series of tests."""

    arm: str
    commands: IsoCommands
    one: Record
    of: Record | None = None


COMMANDED: tuple[Field, ...] = (("arm", "arm"), ("commands", "commands"))
"""First columns of a table of ``Commanded``."""


def pair_fields(
    first: str, second: str, accuracy: str = "accuracy", repeatability: str = "repeatability"
) -> Iterator[Field]:
    """Yield two characteristics of ``Commanded.one`` with their uncertainties, and their number of cycles."""
    for name, attribute in ((first, accuracy), (second, repeatability)):
        yield name, f"one.{attribute}.value_mm", ".3f"
        yield f"U({name})", f"one.{attribute}.expanded_mm", ".3f"
    yield "n", f"one.{accuracy}.n", "d"


def axis_fields() -> Iterator[Field]:
    """Yield the error of ``Commanded.one`` along each axis."""
    for place, axis in enumerate("xyz"):
        yield f"AP {axis}", lambda row, place=place: row.one.error_mm[place], ".3f"


def pair_columns(first: str, second: str) -> tuple[Column, ...]:
    """Build a column for each of two characteristics and its uncertainty."""
    return tuple(number_column(title, ".3f") for name in (first, second) for title in (name, f"U({name})"))


def value_cells(value: IsoValue) -> tuple[Cell, Cell]:
    """Return the cells of a characteristic and its uncertainty."""
    return value.value_mm, value.expanded_mm
