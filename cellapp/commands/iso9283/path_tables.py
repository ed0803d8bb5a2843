"""Tables of paths: AT and RT, velocity, corners."""

from __future__ import annotations

from collections.abc import Iterator

from cellapp.commands.iso9283.cells import pair_columns, series_of, tests_of, value_cells
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.records import Iso9283Result, PathCharacteristics


def path_tables(result: Iso9283Result) -> list[Table]:
    """What was measured along paths."""
    return [_paths(result), _velocities(result), _corners(result)]


# -- inside -----------------------------------------------------------------------------------------------------------


def _paths(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        Column("path"),
        number_column("speed", ".0f", "mm/s"),
        number_column("length", ".0f"),
        *pair_columns("AT", "RT"),
        number_column("n", "d"),
    )
    rows = [
        (
            name,
            kind,
            one.path,
            one.speed_mm_s,
            one.length_mm,
            *value_cells(one.accuracy),
            *value_cells(one.repeatability),
            one.accuracy.n,
        )
        for name, kind, one in _driven(result)
    ]
    return Table("Path accuracy AT and repeatability RT [mm]", columns, tuple(rows))


def _velocities(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        Column("path"),
        number_column("commanded", ".0f", "mm/s"),
        number_column("AV", ".3f", "%"),
        number_column("U(AV)", ".3f", "%"),
        number_column("RV", ".3f", "%"),
        number_column("FV", ".2f", "mm/s"),
        number_column("tracker's FV", ".2f", "mm/s"),
        number_column("n", "d"),
    )
    rows = [
        (
            name,
            kind,
            one.path,
            one.speed_mm_s,
            one.velocity.accuracy_percent,
            one.velocity.expanded_percent,
            one.velocity.repeatability_percent,
            one.velocity.fluctuation_mm_s,
            one.velocity.tracker_fluctuation_mm_s,
            one.velocity.n,
        )
        for name, kind, one in _driven(result)
        if one.velocity is not None
    ]
    return Table("Path velocity: accuracy AV, repeatability RV, fluctuation FV", columns, tuple(rows))


def _corners(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        Column("path"),
        Column("corner"),
        *pair_columns("CR", "CO"),
        number_column("n", "d"),
    )
    rows: list[tuple[Cell, ...]] = [
        (
            name,
            kind,
            one.path,
            corner.corner,
            *value_cells(corner.rounding),
            *value_cells(corner.overshoot),
            corner.rounding.n,
        )
        for name, kind, one in _driven(result)
        for corner in one.corners
        if corner.rounding is not None and corner.overshoot is not None
    ]
    return Table("Cornering deviations: rounding CR and overshoot CO [mm]", columns, tuple(rows))


def _driven(result: Iso9283Result) -> Iterator[tuple[str, IsoCommands, PathCharacteristics]]:
    """Every path with its arm and commands, at all speeds."""
    for name, kind, tests in (*tests_of(result), *series_of(result)):
        for one in tests.path:
            yield name, kind, one
