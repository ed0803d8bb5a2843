"""Tables about the norm and the instrument: what was done and not done, what the tracker can tell."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.commands.view.table import Column, Table, number_column
from cellapp.estimation.iso9283.records import IsoAbility, IsoLine


def abilities_table(abilities: Sequence[IsoAbility]) -> Table:
    """Each tolerance against what an arm without error would show."""
    columns = (
        Column("characteristic"),
        Column("of"),
        number_column("tolerance", ".3f", "mm"),
        number_column("an arm without error shows", ".3f", "mm"),
        number_column("distance", ".1f", "m"),
        number_column("cycles", "d"),
    )
    rows = tuple(
        (one.characteristic.replace("_", " "), one.where, one.tolerance_mm, one.shown_mm, one.distance_m, one.cycles)
        for one in abilities
    )
    return Table("Tolerances against what the tracker can tell", columns, rows)


def coverage_table(lines: Sequence[IsoLine]) -> Table:
    """What the norm asks for: done, done in part or not done, and how or why not."""
    columns = (Column("clause"), Column("characteristic"), Column("arms"), Column("state"), Column("how, or why not"))
    rows = tuple((one.clause, one.characteristic, ", ".join(one.arms), one.status, one.words) for one in lines)
    return Table("What ISO 9283:1998 asks for, done and not done", columns, rows)
