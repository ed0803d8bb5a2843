"""A plan as a section of the report: positions of the stops, expected errors, time, factors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cellapp.cell.planning.duration import planned_time
from cellapp.cell.planning.planned_stops import PlannedStops, read_plan_design, read_planned_stops
from cellapp.cell.planning.records import PlanDesignResult, PlannedTime
from cellapp.cell.run import RunFile
from cellapp.commands.plan.charts import coverage_charts, design_charts
from cellapp.commands.plan.charts_obstacles import cell_map_chart
from cellapp.commands.plan.check_view import (
    design_sentences,
    gaps_table,
    indices_table,
    load_sentences,
    quality_table,
    sweep_sentences,
    sweep_tables,
)
from cellapp.commands.plan.result import PlannedStop
from cellapp.commands.plan.run import planned_stops
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Section, section_of
from cellapp.commands.view.table import Table
from cellapp.ground.profile import Profile


def plan_section(run: RunFile) -> Section | None:
    """Build the section of a run with a plan; None for imported readings."""
    planned, design = planned_stops(run), read_plan_design(run)
    stops, sweeps = planned.stops, planned.sweeps
    if not stops:
        return None
    sentences = [] if design is None else design_sentences(design)
    charts = plan_charts(run.profile, stops, read_planned_stops(run), design)
    about = (
        "Where the planned stops are, in the cell frame and as the tracker sees them, with obstacles and the directions"
        " that these hide, and how much of each joint's range they use."
    )
    if design is not None:
        about += (
            " The stops were chosen to tell most about geometry and effects. Expected errors follow from the tracker's"
            " noise, with geometry and all these effects unknown; beside them are those of random plans of the same"
            " size. 'cellapp docs planning' explains them."
        )
    return section_of(
        "",
        [
            *sentences[1:],
            *load_sentences(planned.loads),
            *sweep_sentences(sweeps),
            *charts,
            *design_tables_of(design),
            *sweep_tables(sweeps),
        ],
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
