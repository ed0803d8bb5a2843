"""Tables of what the tracker measured while an arm moved: paths, velocity, corners, how it comes to rest."""

from __future__ import annotations

from collections.abc import Iterator

from cellapp.commands.iso9283.cells import pair_columns, series_of, tests_of, value_cells
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.records import Iso9283Result, PathCharacteristics


def path_tables(result: Iso9283Result) -> list[Table]:
    """What was measured along paths and at the end of motions."""
    return [_paths(result), _velocities(result), _corners(result), _weaving(result), _settling(result)]


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
        Column("programme"),
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
            one.slowed or "keeps the speed",
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


def _weaving(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        number_column("speed", ".0f", "mm/s"),
        number_column("stroke", ".1f", "mm"),
        number_column("frequency", ".2f", "Hz"),
        number_column("WS", ".2f", "%"),
        number_column("U(WS)", ".2f", "%"),
        number_column("WF", ".2f", "%"),
        number_column("U(WF)", ".2f", "%"),
        number_column("n", "d"),
        Column("programme"),
    )
    rows: list[tuple[Cell, ...]] = [
        (
            name,
            kind,
            one.speed_mm_s,
            one.stroke_mm,
            one.frequency_hz,
            one.stroke_percent,
            one.stroke_expanded_percent,
            one.frequency_percent,
            one.frequency_expanded_percent,
            one.n,
            one.slowed or "keeps the speed",
        )
        for name, kind, tests in tests_of(result)
        if (one := tests.weaving) is not None
    ]
    return Table("Weaving deviations: stroke WS, frequency WF", columns, tuple(rows))


def _settling(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        Column("motion"),
        number_column("length", ".0f", "mm"),
        number_column("limit band", ".3f", "mm"),
        number_column("stabilisation", ".3f", "s"),
        number_column("overshoot", ".3f", "mm"),
        number_column("posing time", ".3f", "s"),
        number_column("n", "d"),
    )
    rows: list[tuple[Cell, ...]] = [
        (
            name,
            kind,
            f"{one.before} to {one.pose}",
            one.distance_mm,
            one.band_mm,
            one.stabilisation_s,
            one.overshoot.value_mm,
            one.posing_s,
            one.overshoot.n,
        )
        for name, kind, tests in tests_of(result)
        if (one := tests.settling) is not None
    ]
    return Table("Stabilisation time, overshoot and posing time", columns, tuple(rows))


def _driven(result: Iso9283Result) -> Iterator[tuple[str, IsoCommands, PathCharacteristics]]:
    """Every path with its arm and commands, at all speeds."""
    for name, kind, tests in tests_of(result):
        for one in tests.path:
            yield name, kind, one
    for name, kind, series in series_of(result):
        for one in series.path:
            yield name, kind, one
