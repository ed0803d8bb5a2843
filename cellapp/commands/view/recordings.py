"""Recordings of motion as a table: counts, rates, gaps, unsteady clocks."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.cell.run.records import RecordingState
from cellapp.commands.view.table import Cell, Column, Table, number_column

_COLUMNS = (
    Column("arm"),
    Column("recording"),
    Column("of"),
    number_column("n", "d"),
    number_column("s", ".1f"),
    number_column("Hz", ".1f"),
    number_column("gaps", "d"),
    number_column("longest [s]", ".3f"),
    number_column("repeats", "d"),
    number_column("clock steps back", "d"),
    number_column("beam lost", "d"),
    Column("with"),
)


_OF_POINTS = ("sigma_m", "quat_w", "split")


def recording_tables(states: Sequence[RecordingState]) -> list[Table]:
    """Build a table with two rows for each recording; no table without recordings."""
    rows: list[tuple[Cell, ...]] = []
    for one in states:
        for kind, its in (("joints", one.joints), ("points", one.points)):
            there = [name for name in one.optional if (name in _OF_POINTS) == (kind == "points")]
            cells = (its.n, its.seconds, its.rate_hz, its.gaps, its.longest_gap_s, its.repeats, its.backward, its.lost)
            rows.append((one.arm, one.name, kind, *cells, ", ".join(there)))
    return [Table("Recordings of motion", _COLUMNS, tuple(rows))] if rows else []
