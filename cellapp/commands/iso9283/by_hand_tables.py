"""Tables and sentences of the manual parts of a test: other loads, forces on the flange."""

from __future__ import annotations

from collections.abc import Iterator

from cellapp.commands.iso9283.cells import COMMANDED, Commanded, pair_fields, tests_of
from cellapp.commands.view.table import Cell, Column, Table, number_column, table_of
from cellapp.estimation.iso9283.records import Iso9283Result
from cellapp.ground.counting import counted


def by_hand_tables(result: Iso9283Result) -> list[Table]:
    """Show pose tests with other loads, and static compliance."""
    return [_loads(result), _compliance(result)]


def by_hand_sentences(result: Iso9283Result) -> Iterator[str]:
    """Yield who did the manual parts, and which of their errors the uncertainties do not include."""
    if not result.by_person:
        return
    who = "the simulated cell itself" if all(one.simulated for one in result.by_person) else "a person"
    yield f"{counted(len(result.by_person), 'step')} at the arms by {who}: loads, and forces as they were asked for"
    if any(tests.compliance for _, _, tests in tests_of(result)):
        yield "the uncertainty of the forces themselves is not in that of the compliance: add that of your force gauge"


# -- inside -----------------------------------------------------------------------------------------------------------


def _loads(result: Iso9283Result) -> Table:
    return table_of(
        "Pose accuracy AP and repeatability RP with other loads [mm]",
        [
            Commanded(name, kind, pose, load)
            for name, kind, tests in tests_of(result)
            for load in tests.loads
            for pose in load.pose
        ],
        *COMMANDED,
        ("load", "of.payload_kg", "g", "kg"),
        ("pose", "one.pose"),
        *pair_fields("AP", "RP"),
    )


def _compliance(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("force along"),
        number_column("up to", ".0f", "N"),
        number_column("moves", ".3f", "mm"),
        number_column("compliance", ".3f", "µm/N"),
        number_column("U", ".3f", "µm/N"),
        number_column("left after", ".3f", "mm"),
        number_column("n", "d"),
    )
    rows: list[tuple[Cell, ...]] = []
    for name, _, tests in tests_of(result):
        for one in tests.compliance:
            last = max(one.steps, key=lambda step: step.force_n)
            moved = last.displacement_mm["xyz".index(one.direction[1])] * (1.0 if one.direction[0] == "+" else -1.0)
            sizes = (last.force_n, moved, one.compliance_um_n, one.expanded_um_n, one.left_mm, one.n)
            rows.append((name, one.direction, *sizes))
    return Table("Static compliance at P1: displacement along the force, axes of the arm's base", columns, tuple(rows))
