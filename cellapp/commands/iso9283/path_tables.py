"""Tables of measurements in motion: paths, velocity, corners, weaving, settling."""

from __future__ import annotations

from collections.abc import Iterator

from cellapp.commands.iso9283.cells import COMMANDED, Commanded, pair_fields, series_of, tests_of
from cellapp.commands.view.table import Cell, Column, Table, number_column, table_of
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.records import Iso9283Result, PathCharacteristics


def path_tables(result: Iso9283Result) -> list[Table]:
    """Show measurements along paths and at the end of motions."""
    return [_paths(result), _velocities(result), _corners(result), _weaving(result), _settling(result)]


# -- inside -----------------------------------------------------------------------------------------------------------


def _paths(result: Iso9283Result) -> Table:
    return table_of(
        "Path accuracy AT and repeatability RT [mm]",
        [Commanded(*driven) for driven in _driven(result)],
        *COMMANDED,
        ("path", "one.path"),
        ("speed", "one.speed_mm_s", ".0f", "mm/s"),
        ("length", "one.length_mm", ".0f"),
        *pair_fields("AT", "RT"),
    )


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
    return table_of(
        "Cornering deviations: rounding CR and overshoot CO [mm]",
        [
            Commanded(name, kind, corner, path)
            for name, kind, path in _driven(result)
            for corner in path.corners
            if corner.rounding is not None and corner.overshoot is not None
        ],
        *COMMANDED,
        ("path", "of.path"),
        ("corner", "one.corner"),
        *pair_fields("CR", "CO", "rounding", "overshoot"),
    )


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
    return table_of(
        "Stabilisation time, overshoot and posing time",
        [Commanded(name, kind, tests.settling) for name, kind, tests in tests_of(result) if tests.settling is not None],
        *COMMANDED,
        ("motion", lambda row: f"{row.one.before} to {row.one.pose}"),
        ("length", "one.distance_mm", ".0f", "mm"),
        ("limit band", "one.band_mm", ".3f", "mm"),
        ("stabilisation", "one.stabilisation_s", ".3f", "s"),
        ("overshoot", "one.overshoot.value_mm", ".3f", "mm"),
        ("posing time", "one.posing_s", ".3f", "s"),
        ("n", "one.overshoot.n", "d"),
    )


def _driven(result: Iso9283Result) -> Iterator[tuple[str, IsoCommands, PathCharacteristics]]:
    """Yield every path with its arm and commands, at all speeds."""
    for name, kind, tests in tests_of(result):
        for one in tests.path:
            yield name, kind, one
    for name, kind, series in series_of(result):
        for one in series.path:
            yield name, kind, one
