"""The results of ``plan`` as tables and sentences: a plan that was made, a check, a forecast, stored stops."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from cellapp.cell.driving.records import PlannedStop, PlanResult, StopsResult
from cellapp.cell.planning.planned_stops import PlannedStops, planned_time, read_plan_design, read_planned_stops
from cellapp.cell.planning.records import PlanCheckResult, PlanDesignResult, PlanForecastResult, PlannedTime
from cellapp.cell.run import RunFile
from cellapp.commands.plan.charts import cell_map_chart, coverage_charts, design_charts
from cellapp.commands.plan.check_view import (
    check_sentences,
    design_sentences,
    design_tables,
    forecast_sentences,
    forecast_tables,
    gaps_table,
    indices_table,
    load_sentences,
    plan_lines,
    plan_result_tables,
    quality_table,
    sweep_sentences,
)
from cellapp.commands.plan.run import planned_stops
from cellapp.commands.record import Request, View
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Section, section_of
from cellapp.commands.view.table import Table, columns_of
from cellapp.ground.profile import Profile

_DEG = ".2f"
"""Number format of joint angles in degrees."""


def view(
    result: PlanResult | PlanCheckResult | PlanForecastResult | StopsResult, request: Request | None = None
) -> View:
    """Show what was planned, refused or predicted; a check fails if the gate refuses something."""
    match result:
        case PlanResult():
            said = (*plan_lines(result), *sweep_sentences(result.sweeps))
            return View((*plan_result_tables(result), *said), held="; ".join(result.notes))
        case PlanCheckResult():
            verdict, *offences = check_sentences(result)
            return View((*offences, verdict), held=verdict) if result.is_safe else View(offences, (verdict,), "plan")
        case PlanForecastResult():
            return View((*forecast_tables(result), *forecast_sentences(result)))
    planned = () if result.stops else ("no stops are planned",)
    design = result.design
    told: tuple[Table | str, ...] = () if design is None else (*design_tables(design), *design_sentences(design))
    swept: tuple[Table | str, ...] = tuple(sweep_sentences(result.sweeps))
    return View((*plan_tables(result), *planned, *told, *load_sentences(result.loads), *swept))


def plan_tables(stops: StopsResult) -> list[Table]:
    """Show joint angles [deg] of every planned stop, one table for each arm."""
    tables = []
    for name in stops.stops[0].q if stops.stops else ():
        joints = len(stops.stops[0].q[name])
        columns = columns_of(("stop", "d"), "measured", *((f"q{joint}", _DEG, "deg") for joint in range(1, joints + 1)))
        rows = tuple(
            (stop.configuration + 1, "yes" if stop.measured else "no", *map(math.degrees, stop.q[name]))
            for stop in stops.stops
        )
        tables.append(Table(f"Arm {name}: planned stops", columns, rows))
    return tables


def plan_section(run: RunFile) -> Section | None:
    """Build the section of a run with a plan; None for imported readings."""
    planned, design = planned_stops(run), read_plan_design(run)
    stops, sweeps = planned.stops, planned.sweeps
    if not stops:
        return None
    sentences = [] if design is None else design_sentences(design)
    charts = plan_charts(run.profile, stops, read_planned_stops(run), design)
    about = (
        "Where the planned stops are, in the cell frame and as the tracker sees them, with obstacles,"
        " and how much of each joint's range they use."
    )
    if design is not None:
        about += (
            " The stops were chosen to tell most about geometry and effects. Expected errors follow from the tracker's"
            " noise, with geometry and all these effects unknown; beside them are those of random plans of the same"
            " size. 'cellapp docs planning' explains them."
        )
    return section_of(
        [*sentences[1:], *load_sentences(planned.loads), *sweep_sentences(sweeps), *charts, *design_tables_of(design)],
        message=sentences[0] if sentences else "Where the planned stops are, and what limits them.",
        about=about,
    )


def plan_charts(
    profile: Profile, stops: Sequence[PlannedStop], ways: PlannedStops, design: PlanDesignResult | None
) -> Iterator[Chart]:
    """Yield the cell from above and from the tracker, the design's charts, and joint ranges."""
    yield cell_map_chart(profile, stops)
    yield cell_map_chart(profile, stops, "tracker")
    yield from design_charts_of(profile, stops, ways, design)


def design_charts_of(
    profile: Profile, stops: Sequence[PlannedStop], ways: PlannedStops, design: PlanDesignResult | None
) -> tuple[Chart, ...]:
    """Show what is known of the design, the expected time and the joint ranges."""
    asked = ways.take([row for row in range(len(ways)) if row not in profile.plan.reserves(len(ways))])
    return (*design_charts(design, _time(profile, asked)), *coverage_charts(profile, stops))


def design_tables_of(design: PlanDesignResult | None) -> tuple[Table, ...]:
    """Show errors beside random stops, observability and largest gaps; none if the plan was not designed."""
    return () if design is None else (quality_table(design), indices_table(design), gaps_table(design))


def _time(profile: Profile, ways: PlannedStops) -> PlannedTime | None:
    """Estimate the time of collecting; None if an arm has no home position and is thus not driven."""
    if not len(ways) or any(profile.arms[name].home is None for name in ways.q):
        return None
    return planned_time(profile, ways)
