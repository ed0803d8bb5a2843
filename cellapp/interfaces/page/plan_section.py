"""The page's section on the plan: where its stops are, what they tell, time, factors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cellapp.cell.planning.duration import planned_time
from cellapp.cell.planning.stored_stops import read_plan_design, read_planned_stops
from cellapp.cell.run import RunFile
from cellapp.commands.plan.design_view import design_sentences, gaps_table, indices_table, quality_table
from cellapp.commands.plan.run import planned_stops
from cellapp.commands.view.table import Table
from cellapp.interfaces.page.captioned import CaptionedFigure
from cellapp.interfaces.page.chart_figure import chart_figure

if TYPE_CHECKING:
    from cellapp.cell.planning.design_records import PlanDesignResult
    from cellapp.cell.planning.planned_stops import PlannedStops
    from cellapp.cell.planning.records import PlannedTime
    from cellapp.commands.plan.result import PlannedStop
    from cellapp.commands.view.charts import Chart
    from cellapp.ground.profile import Profile


@dataclass(frozen=True)
class PlanSection:
    """What the page shows of a plan; sentences and tables only of one that was designed."""

    figures: tuple[CaptionedFigure, ...]
    tables: tuple[Table, ...] = ()
    sentences: tuple[str, ...] = ()


def plan_section(run: RunFile) -> PlanSection | None:
    """The section of a run with a plan; None for imported readings."""
    stops, design = planned_stops(run).stops, read_plan_design(run)
    if not stops:
        return None
    charts = plan_charts(run.profile, stops, read_planned_stops(run), design)
    figures = tuple(chart_figure(f"plan{number}", chart) for number, chart in enumerate(charts, start=1))
    sentences = () if design is None else tuple(design_sentences(design))
    return PlanSection(figures, design_tables_of(design), sentences)


def plan_charts(
    profile: Profile, stops: Sequence[PlannedStop], ways: PlannedStops, design: PlanDesignResult | None
) -> Iterator[Chart]:
    """The cell from above and from the tracker, joint ranges, and what is known of the design."""
    from cellapp.commands.calibrate.charts_map import cell_map_chart

    yield cell_map_chart(profile, stops)
    yield cell_map_chart(profile, stops, "tracker")
    yield from design_charts_of(profile, stops, ways, design)


def design_charts_of(
    profile: Profile, stops: Sequence[PlannedStop], ways: PlannedStops, design: PlanDesignResult | None
) -> tuple[Chart, ...]:
    """What is known of the design, the expected time, joint ranges."""
    from cellapp.commands.plan.charts import coverage_charts, design_charts

    asked = ways.take([row for row in range(len(ways)) if row not in profile.plan.reserves(len(ways))])
    return (*design_charts(design, _time(profile, asked)), *coverage_charts(profile, stops))


def design_tables_of(design: PlanDesignResult | None) -> tuple[Table, ...]:
    """Expected errors against random stops, observability and largest gaps; none of a plan that was not designed."""
    return () if design is None else (quality_table(design), indices_table(design), gaps_table(design))


def _time(profile: Profile, ways: PlannedStops) -> PlannedTime | None:
    """Expected time of collecting; None for arms without a home position, which are not driven."""
    if not len(ways) or any(profile.arms[name].home is None for name in ways.q):
        return None
    return planned_time(profile, ways)
