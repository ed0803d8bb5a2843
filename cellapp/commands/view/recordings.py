"""Recordings of motion as a table: counts, rates, gaps, unsteady clocks."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.cell.run.records import RecordingState
from cellapp.commands.view.table import Cell, Table, columns_of

_COLUMNS = columns_of(
    "arm",
    "recording",
    "of",
    ("n", "d"),
    ("s", ".1f"),
    ("Hz", ".1f"),
    ("gaps", "d"),
    ("longest [s]", ".3f"),
    ("repeats", "d"),
    ("clock steps back", "d"),
    ("beam lost", "d"),
    "with",
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
