"""Check and forecast of a plan before it is measured, as tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.cell.planning.planned_stops import PlannedStops
from cellapp.cell.planning.records import (
    ArmDesign,
    ArmForecast,
    FactorCorrelation,
    ObservabilityIndices,
    PlanCheckResult,
    PlanDesignResult,
    PlanForecastResult,
    PlannedTime,
    PlanRefusal,
)
from cellapp.commands.plan.result import PlannedLoad, PlanResult, StopsResult, SweepCount
from cellapp.commands.view.charts import enumerated
from cellapp.commands.view.table import Cell, Table, table_of, table_of_cells
from cellapp.commands.view.words import geometry_unit, short_reason
from cellapp.estimation.discovery.records import PlannedEffect
from cellapp.ground.counting import counted
from cellapp.ground.progress import duration_words
from cellapp.robot.effects import EFFECTS

TIME_RESTS_ON = (
    "the profile's speeds and averaging time, 1 s to find each SMR, 0.2 s of rest; waits and persons are not counted"
)


def check_sentences(check: PlanCheckResult) -> list[str]:
    """Return the verdict, then every refusal."""
    refusals = [
        refusal_sentence(one) if check.file is None else file_refusal_sentence(check, one) for one in check.refused
    ]
    if check.is_safe:
        detours = f"; {len(refusals)} ways take a detour" if refusals else ""
        kept = f"{counted(check.stops, 'stop')} and {check.ways} ways keep their clearance"
        return [f"Safe: {kept}, the tracker sees every SMR{detours}.", *refusals]
    bad = sum(not one.is_avoided for one in check.refused)
    return [f"Not safe: {bad} of {counted(check.stops, 'stop')} and {check.ways} ways are refused.", *refusals]


def refusal_sentence(one: PlanRefusal) -> str:
    """State one refusal: where, why, and what to do."""
    stop = "home" if one.configuration is None else f"stop {one.configuration + 1}"
    if one.what != "way":
        return f"{stop}: {one.reason}; plan again, or change base, limits or clearance in the profile"
    before = "home" if one.before is None else f"stop {one.before + 1}"
    after = "no way via home is free either: the stop would be left out"
    if one.is_avoided:
        after = f"the arms go {one.detour or 'via home'}"
    return f"from {before} to {stop}: {one.reason}; {after}"


def stop_words(stops: PlannedStops, stop: int) -> str:
    """Say how a stop is reached and what it is for: path, last motion, rest, repetition."""
    words = []
    if (source := int(stops.repeat_of[stop])) >= 0:
        words.append(f"repeats stop {source + 1}")
    if legs := len(stops.legs[stop]):
        words.append(f"via {counted(legs, 'position')}")
    if starts := stops.approach_starts(stop):
        sizes = [math.degrees(float(np.abs(stops.q[name][stop] - q).max())) for name, q in starts.items()]
        words.append(f"last motion {enumerated(f'{size:.1f}' for size in sizes)} deg")
    rests = [float(rest[stop]) for rest in stops.dwell_s.values()]
    if any(rests):
        words.append(f"rests {enumerated(f'{rest:.0f}' for rest in rests)} s")
    return ", ".join(words) or "straight"


def file_refusal_sentence(check: PlanCheckResult, one: PlanRefusal) -> str:
    """State one refusal of a hand-edited plan, by line and configuration."""
    where = f"{check.file}:{one.line}: configuration {one.configuration}"
    if one.configuration is None:
        where = f"{check.file}:{one.line}: home after configuration {one.before}"
    detour = f"; the arms go {one.detour or 'via home'}" if one.is_avoided else ""
    return f"{where}: {'the way there: ' if one.what == 'way' else ''}{one.reason}{detour}"


def forecast_tables(forecast: PlanForecastResult) -> list[Table]:
    """Show joint ranges, expected standard errors, effects and parameters, for each arm."""
    tables = []
    for name, arm in forecast.arms.items():
        tables += [coverage_table(name, arm), accuracy_table(name, arm), effects_table(name, arm)]
    return tables


def forecast_sentences(forecast: PlanForecastResult) -> list[str]:
    """State the time and its assumptions, the assumptions of the effects' sizes, and notes."""
    noise = ", ".join(f"arm {name} {arm.noise_rms_mm:.3f} mm" for name, arm in forecast.arms.items())
    return [
        f"{time_sentence(forecast.time)} It rests on {TIME_RESTS_ON}.",
        f"Sizes of effects are for the tracker's noise alone (rms {noise}); scatter of the arms makes them larger.",
        *forecast.notes,
    ]


def time_sentence(time: PlannedTime) -> str:
    """Say how long collecting takes, and on what it is spent; the estimate rests on ``TIME_RESTS_ON``."""
    parts = (
        ("motions", time.moving_s),
        ("rests", time.resting_s),
        ("measuring", time.measuring_s),
        ("references", time.references_s),
        ("warm-up", time.warm_up_s),
    )
    spent = ", ".join(f"{name} {duration_words(seconds)}" for name, seconds in parts if seconds > 0.0)
    return f"Collecting takes about {duration_words(time.total_s)} ({spent})."


def coverage_table(name: str, arm: ArmForecast) -> Table:
    """Show the allowed and used range and the largest gap of each joint."""
    return table_of(
        f"Arm {name}: joint ranges of {counted(arm.stops, 'stop')}",
        arm.coverage,
        ("joint", "joint", "d"),
        ("allowed from", lambda one: math.degrees(one.allowed[0]), ".0f", "deg"),
        ("to", lambda one: math.degrees(one.allowed[1]), ".0f", "deg"),
        ("used from", lambda one: math.degrees(one.used[0]), ".0f", "deg"),
        ("to", lambda one: math.degrees(one.used[1]), ".0f", "deg"),
        ("share", "share", ".0f", "%"),
        ("largest gap", lambda one: math.degrees(one.largest_gap), ".0f", "deg"),
    )


def accuracy_table(name: str, arm: ArmForecast) -> Table:
    """Show expected standard errors of predicted positions and of parameters, one column for each scatter."""
    headings = ["tracker alone" if one.scatter_mm == 0.0 else f"{one.scatter_mm:g} mm scatter" for one in arm.accuracy]
    rows: list[tuple[Cell, ...]] = [
        ("predicted position, rms", *(one.standard_error_mm for one in arm.accuracy), "mm"),
        ("predicted position, largest", *(one.largest_mm for one in arm.accuracy), "mm"),
    ]
    for parameter in dict.fromkeys(key for one in arm.accuracy for key in one.parameters):
        found = [one.parameters.get(parameter) for one in arm.accuracy]
        unit = next(entry.unit for entry in found if entry is not None)
        factor, shown = geometry_unit(unit)
        errors = [
            None if entry is None or entry.standard_error is None else factor * entry.standard_error for entry in found
        ]
        rows.append((parameter, *errors, shown))
    scatters = ((title, ".4f") for title in headings)
    return table_of_cells(f"Arm {name}: expected standard errors", rows, "standard error of", *scatters, "unit")


def effects_table(name: str, arm: ArmForecast) -> Table:
    """Show whether the plan can show each effect, and from which displacement of the SMR on."""
    return table_of(
        f"Arm {name}: effects that the plan can show",
        arm.effects,
        ("effect", effect_title),
        ("visible", lambda one: "yes" if one.visible else "no"),
        ("seen from", lambda one: one.smallest_seen_rms_mm if one.visible else None, ".4f", "mm rms"),
        ("with scatter", lambda one: one.with_scatter_rms_mm if one.visible else None, ".4f", "mm rms"),
        ("why not", lambda one: "" if one.visible else short_reason(one.reason)),
    )


def effect_title(one: PlannedEffect) -> str:
    """Return the title of an effect; its slug if this version does not know it."""
    return EFFECTS[one.effect].title if one.effect in EFFECTS else one.effect


# -- A new plan and the quality of its design, as tables and sentences ------------------------------------------------


_SINGULAR = 1e-9
"""Smallest condition number (O2) of stops that determine all parameters; some tens of stops reach 1e-3."""


def plan_lines(result: PlanResult) -> list[str]:
    """State the stops of each arm, the time of collecting, and notes."""
    more = f" and {result.reserves} in reserve" if result.reserves else ""
    lines = [f"arm {name}: {counted(count, 'stop')} planned{more}" for name, count in result.stops.items()]
    lines += [] if result.time is None else [f"{time_sentence(result.time)} It rests on {TIME_RESTS_ON}."]
    return [*lines, *result.notes]


def design_parts(plan: PlanResult | StopsResult) -> list[Table | str]:
    """Show how good the design is if the plan was designed, its loads and its sweeps."""
    designed: list[Table | str] = []
    if plan.design is not None:
        designed = [*design_tables(plan.design), *design_sentences(plan.design)]
    return [*designed, *load_sentences(plan.loads), *sweep_sentences(plan.sweeps)]


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
    """Show candidates, errors beside random stops, observability; errors by number of stops."""
    tables = [candidates_table(design), quality_table(design), indices_table(design)]
    return [*tables, *(by_stops_table(name, arm) for name, arm in design.arms.items() if arm.by_stops)]


def design_sentences(design: PlanDesignResult) -> list[str]:
    """State the balance of the factors, travel time, detours, blocks, repeats, and notes."""
    travel = design.travel
    sentences = [
        f"Travel takes {duration_words(travel.planned_s)}, in random order {duration_words(travel.random_order_s)}.",
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
    """Show how many configurations were sampled for each arm, why some were rejected, and how many are left."""
    found = (reason for arm in design.arms.values() for reason, count in arm.rejected.items() if count)
    reasons = list(dict.fromkeys(found))
    arms = design.arms.values()
    rows: list[tuple[Cell, ...]] = [
        ("sampled", *(arm.drawn for arm in arms)),
        *((f"excluded by {reason}", *(arm.rejected.get(reason) for arm in arms)) for reason in reasons),
        ("candidates", *(arm.candidates for arm in arms)),
    ]
    return table_of_cells("Candidates", rows, "configurations", *((f"arm {name}", "d") for name in design.arms))


def quality_table(design: PlanDesignResult) -> Table:
    """Show expected errors of the designed and of random stops; how many random stops do as well."""
    rows = list[tuple[Cell, ...]]()
    for name, arm in design.arms.items():
        for word, one in (("designed", arm.designed), ("random", arm.random)):
            rows.append((name, word, one.stops, one.parameters, one.mean_mm, one.worst_mm))
        equal = arm.equal_to_random
        counts = (equal.get("parameters"), equal.get("mean"), equal.get("worst"))
        rows.append((name, "equal to random", None, *(_stops(count) for count in counts)))
    numbers = ("stops", "d"), ("parameters", ".3f"), ("mean", ".4f", "mm"), ("worst", ".4f", "mm")
    return table_of_cells("Expected errors against random stops", rows, "arm", "plan", *numbers)


def indices_table(design: PlanDesignResult) -> Table:
    """Show observability indices of the designed stops and of random ones."""
    rows = (
        (name, word, *_indices(index))
        for name, arm in design.arms.items()
        for word, index in (("designed", arm.designed.indices), ("random", arm.random.indices))
    )
    return table_of_cells("Observability", rows, "arm", "plan", *((f"O{index}", ".3g") for index in range(1, 6)))


def _indices(index: ObservabilityIndices) -> tuple[float | None, ...]:
    """Return the five indices; None each if the stops are too few to determine all parameters."""
    if index.o2 < _SINGULAR:
        return (None,) * 5
    return index.o1, index.o2, index.o3, index.o4, index.o5


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


# -- Planned sweeps as tables and sentences: how many, and their forecast beside that of the stops --------------------


def sweep_sentences(sweeps: Mapping[str, SweepCount] | None) -> list[str]:
    """Say how many sweeps each arm makes, and how long they last."""
    if not sweeps:
        return []
    return [
        f"arm {name}: {counted(its.n, 'sweep')} about its stops, {its.seconds / 60.0:.1f} min"
        + (f"; the other arm swings beside {its.swinging} of them" if its.swinging else "")
        for name, its in sweeps.items()
    ]
