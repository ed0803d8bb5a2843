"""Tables about the norm and the instrument: what was and was not done, what the tracker can resolve."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.commands.view.table import Table, table_of
from cellapp.estimation.iso9283.records import IsoAbility, IsoLine


def abilities_table(abilities: Sequence[IsoAbility]) -> Table:
    """Show each tolerance beside what an arm without error would show."""
    return table_of(
        "Tolerances against what the tracker can tell",
        abilities,
        ("characteristic", lambda one: one.characteristic.replace("_", " ")),
        ("of", "where"),
        ("tolerance", "tolerance_mm", ".3f", "mm"),
        ("an arm without error shows", "shown_mm", ".3f", "mm"),
        ("distance", "distance_m", ".1f", "m"),
        ("cycles", "cycles", "d"),
    )


def coverage_table(lines: Sequence[IsoLine]) -> Table:
    """Show what the norm requires: done, done in part or not done, and how or why not."""
    return table_of(
        "What ISO 9283:1998 asks for, done and not done",
        lines,
        ("clause", "clause"),
        ("characteristic", "characteristic"),
        ("arms", lambda one: ", ".join(one.arms)),
        ("state", "status"),
        ("how, or why not", "words"),
    )
