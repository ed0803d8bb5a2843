"""A new plan and the quality of its design, as tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cellapp.cell.driving.records import PlannedLoad, PlanResult
from cellapp.cell.planning.design_records import ArmDesign, FactorCorrelation, ObservabilityIndices, PlanDesignResult
from cellapp.commands.plan.check_view import TIME_RESTS_ON, duration_words, time_sentence
from cellapp.commands.view.table import Cell, Column, Table, number_column, table_of
from cellapp.ground.counting import counted

_SINGULAR = 1e-9
"""Smallest condition number (O2) of stops that determine all parameters; some tens of stops reach 1e-3."""


def plan_result_tables(result: PlanResult) -> list[Table]:
    """Build the tables of a new plan; none for random stops."""
    return [] if result.design is None else design_tables(result.design)


def plan_lines(result: PlanResult) -> list[str]:
    """State the stops of each arm, the quality of their design, the time of collecting, and notes."""
    more = f" and {result.reserves} in reserve" if result.reserves else ""
    lines = [f"arm {name}: {counted(count, 'stop')} planned{more}" for name, count in result.stops.items()]
    lines += [] if result.design is None else design_sentences(result.design)
    lines += [] if result.time is None else [f"{time_sentence(result.time)} It rests on {TIME_RESTS_ON}."]
    return [*lines, *load_sentences(result.loads), *result.notes]


def load_sentences(loads: Sequence[PlannedLoad] | None) -> list[str]:
    """Say with which load each part of a plan is measured, and what a person does between; none for a single load."""
    if not loads:
        return []
    parts = [
        f"stops {one.first} to {one.last} with {', '.join(f'{name} {kg:g} kg' for name, kg in one.payload_kg.items())}"
        for one in loads
    ]
    return [f"Loads: {'; '.join(parts)}. Before each further load the arms go home, and a person hangs it."]


def design_tables(design: PlanDesignResult) -> list[Table]:
    """Show candidates, errors beside random stops, observability, largest gaps; errors by number of stops."""
    tables = [candidates_table(design), quality_table(design), indices_table(design), gaps_table(design)]
    return [*tables, *(by_stops_table(name, arm) for name, arm in design.arms.items() if arm.by_stops)]


def design_sentences(design: PlanDesignResult) -> list[str]:
    """State the balance of the factors, travel time, detours, blocks, repeats, and notes."""
    travel = design.travel
    sentences = [
        f"Travel takes {duration_words(travel.planned_s)}, in random order {duration_words(travel.random_order_s)}:"
        f" {100.0 * travel.saved:.0f} % are saved.",
        f"{counted(design.detours, 'stop is', 'stops are')} reached by a detour,"
        f" {counted(design.repeats, 'stop repeats', 'stops repeat')} an earlier one,"
        f" in {counted(design.blocks, 'block', 'blocks')}.",
    ]
    largest = design.largest_correlation
    if largest is not None:
        sentences.insert(0, f"Largest correlation of a planned factor: {correlation_words(largest)}.")
    return [*sentences, *design.notes]


def correlation_words(one: FactorCorrelation) -> str:
    """Return a correlation as "0.04 (approach side of joint 2 of left with time)"."""
    return f"{abs(one.correlation):.2f} ({one.factor} with {one.other})"


def candidates_table(design: PlanDesignResult) -> Table:
    """Show how many configurations were drawn for each arm, why some were rejected, and how many are left."""
    found = (reason for arm in design.arms.values() for reason, count in arm.rejected.items() if count)
    reasons = list(dict.fromkeys(found))
    columns = (Column("configurations"), *(number_column(f"arm {name}", "d") for name in design.arms))
    arms = design.arms.values()
    rows: list[tuple[Cell, ...]] = [
        ("drawn", *(arm.drawn for arm in arms)),
        *((f"excluded by {reason}", *(arm.rejected.get(reason) for arm in arms)) for reason in reasons),
        ("candidates", *(arm.candidates for arm in arms)),
    ]
    return Table("Candidates", columns, tuple(rows))


def quality_table(design: PlanDesignResult) -> Table:
    """Show expected errors of the designed and of random stops; how many random stops do as well."""
    columns = (
        Column("arm"),
        Column("plan"),
        number_column("stops", "d"),
        number_column("parameters", ".3f"),
        number_column("mean", ".4f", "mm"),
        number_column("worst", ".4f", "mm"),
    )
    rows: list[tuple[Cell, ...]] = []
    for name, arm in design.arms.items():
        for word, one in (("designed", arm.designed), ("random", arm.random)):
            rows.append((name, word, one.stops, one.parameters, one.mean_mm, one.worst_mm))
        equal = arm.equal_to_random
        counts = (equal.get("parameters"), equal.get("mean"), equal.get("worst"))
        rows.append((name, "equal to random", None, *(_stops(count) for count in counts)))
    return Table("Expected errors against random stops", columns, tuple(rows))


def indices_table(design: PlanDesignResult) -> Table:
    """Show observability indices of the designed stops and of random ones."""
    columns = (Column("arm"), Column("plan"), *(number_column(f"O{index}", ".3g") for index in range(1, 6)))
    rows: list[tuple[Cell, ...]] = [
        (name, word, *_indices(index))
        for name, arm in design.arms.items()
        for word, index in (("designed", arm.designed.indices), ("random", arm.random.indices))
    ]
    return Table("Observability", columns, tuple(rows))


def _indices(index: ObservabilityIndices) -> tuple[float | None, ...]:
    """Return the five indices; None each if the stops are too few to determine all parameters."""
    if index.o2 < _SINGULAR:
        return (None,) * 5
    return index.o1, index.o2, index.o3, index.o4, index.o5


def gaps_table(design: PlanDesignResult) -> Table:
    """Show the largest gap between stops in each joint's travelled range [deg]."""
    joints = max((len(arm.largest_gap) for arm in design.arms.values()), default=0)
    columns = (Column("arm"), *(number_column(f"q{joint + 1}", ".1f", "deg") for joint in range(joints)))
    rows: list[tuple[Cell, ...]] = [
        (name, *map(math.degrees, arm.largest_gap), *[None] * (joints - len(arm.largest_gap)))
        for name, arm in design.arms.items()
    ]
    return Table("Largest gap of each joint", columns, tuple(rows))


def by_stops_table(name: str, arm: ArmDesign) -> Table:
    """Show expected errors after the first n stops."""
    return table_of(
        f"Arm {name}: errors after the first stops",
        arm.by_stops,
        ("stops", "stops", "d"),
        ("parameters", "parameters", ".3f"),
        ("mean", "mean_mm", ".4f", "mm"),
        ("worst", "worst_mm", ".4f", "mm"),
    )


def _stops(count: float | None) -> str | None:
    return None if count is None else f"{count:.0f} stops"
