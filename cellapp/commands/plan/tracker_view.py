"""Share of each arm's workspace that the tracker sees, as tables and sentences."""

from __future__ import annotations

import math

from cellapp.cell.planning.design_records import ArmView, ConstraintShare, ViewResult
from cellapp.cell.safety.visibility import FACING
from cellapp.commands.view.charts import enumerated
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.ground.counting import counted

_WORTH_A_CHANGE = 1.1
"""Least gain in configurations for which a change is advised: less is within the scatter of the draws."""
_NATURAL = 0.5
"""Share of what random directions would give, from which on the SMR's direction does not count as the problem."""
AS_IT_IS = "as it is"
"""Name of the unchanged cell in the list of changes."""


def view_tables(view: ViewResult) -> list[Table]:
    """Show the constraints and the workspace by height of each arm."""
    return [
        table for name, arm in view.arms.items() for table in (constraint_table(name, arm), height_table(name, arm))
    ]


def view_sentences(view: ViewResult) -> list[str]:
    """Say for each arm how much the tracker sees, which constraint costs most, and what would help."""
    return [sentence for name, arm in view.arms.items() for sentence in arm_sentences(name, arm)]


def constraint_table(name: str, arm: ArmView) -> Table:
    """Show each constraint in the order applied: share lost to it, share it excludes alone, share without it."""
    columns = (
        Column("constraint"),
        number_column("lost to it", ".2f", "%"),
        number_column("excludes alone", ".2f", "%"),
        number_column("seen without it", ".2f", "%"),
    )
    by_name = {one.constraint: one for one in arm.constraints}
    rows: list[tuple[Cell, ...]] = []
    for constraint, lost in arm.lost.items():
        one = by_name[constraint]
        rows.append((constraint, 100.0 * lost, 100.0 * one.alone, 100.0 * one.without))
    rows.append(("seen", 100.0 * arm.share, None, None))
    return Table(f"Arm {name}: what excludes {counted(arm.drawn, 'configuration')}", columns, tuple(rows))


def height_table(name: str, arm: ArmView) -> Table:
    """Show the workspace in layers of cubes, highest first: cubes that the SMR reaches, and cubes where it is seen.

    ``share`` is the share of the configurations with the SMR in the layer that can be measured.
    """
    columns = (
        number_column("z", ".2f", "m"),
        number_column("cubes", "d"),
        number_column("seen", "d"),
        number_column("share", ".2f", "%"),
        number_column("best cube", ".2f", "%"),
        number_column("its x", ".2f", "m"),
        number_column("its y", ".2f", "m"),
    )
    rows: list[tuple[Cell, ...]] = []
    for height in sorted({cube.centre_C[2] for cube in arm.cells}, reverse=True):
        layer = [cube for cube in arm.cells if cube.centre_C[2] == height]
        best = max(layer, key=lambda cube: cube.share)
        reached, seen = sum(cube.reachable for cube in layer), sum(cube.seen for cube in layer)
        at = best.centre_C[:2] if seen else (None, None)
        rows.append(
            (height, len(layer), sum(cube.seen > 0 for cube in layer), 100.0 * seen / reached, 100.0 * best.share, *at)
        )
    return Table(f"Arm {name}: workspace in cubes of {1e3 * arm.edge_m:.0f} mm", columns, tuple(rows))


def arm_sentences(name: str, arm: ArmView) -> list[str]:
    """Say how much of an arm's workspace is seen, what excludes most of the rest, what would help."""
    seen = sum(cube.seen > 0 for cube in arm.cells)
    straight = 100.0 * arm.small_incidence / max(arm.seen, 1)
    return [
        f"Arm {name}: the tracker can measure {100.0 * arm.share:.2f} % of configurations, {straight:.0f} % of these"
        f" with full accuracy, and the SMR in {seen} of {len(arm.cells)} cubes of {1e3 * arm.edge_m:.0f} mm.",
        *_facing_sentence(arm),
        *_worst_sentence(arm),
        _change_sentence(arm),
    ]


def worst_constraint(arm: ArmView) -> ConstraintShare | None:
    """Return the constraint that costs most configurations; facing counts only if worse than random directions."""
    blamed = [
        one for one in arm.constraints if one.without > arm.share and not (one.constraint == FACING and _faces(arm))
    ]
    return max(blamed, key=lambda one: one.without, default=None)


def _faces(arm: ArmView) -> bool:
    """Return whether the SMR faces the tracker about as often as random directions would."""
    facing = next((one for one in arm.constraints if one.constraint == FACING), None)
    return facing is not None and 1.0 - facing.alone >= _NATURAL * arm.facing_at_random


def _facing_sentence(arm: ArmView) -> list[str]:
    if not _faces(arm):
        return []
    facing = next(one for one in arm.constraints if one.constraint == FACING)
    natural = 100.0 * (1.0 - arm.facing_at_random)
    return [
        f"In {100.0 * facing.alone:.1f} % the SMR looks away from the tracker; of directions at random {natural:.1f} %"
        " do, so its mounting is not to blame."
    ]


def _worst_sentence(arm: ArmView) -> list[str]:
    worst = worst_constraint(arm)
    if worst is None:
        return []
    then = " then" if _faces(arm) else ""
    return [
        f"What costs most{then} is '{worst.constraint}': it excludes {100.0 * worst.alone:.1f} % ({worst.extent});"
        f" without it {100.0 * worst.without:.2f} % could be measured. What helps: {worst.advice}."
    ]


def _change_sentence(arm: ArmView) -> str:
    now = next((one.seen for one in arm.changes if one.change == AS_IT_IS), arm.share)
    better = [one for one in arm.changes if one.seen > _WORTH_A_CHANGE * now and not math.isclose(one.seen, now)]
    tried = len(arm.changes) - 1
    if not better:
        return f"None of {tried} changes that were tried (tracker moved, SMR turned) gains a tenth."
    words = enumerated(f"{100.0 * one.seen:.2f} % with {one.change}" for one in better[:3])
    return f"Of {tried} changes that were tried, these give more than the {100.0 * now:.2f} % as it is: {words}."
