"""The page's section on the plan: where its stops are, what they tell, time, factors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cellapp.planning.stored_stops import read_plan_design
from cellapp.reporting.captioned import CaptionedFigure
from cellapp.reporting.table import Table
from cellapp.run import RunFile
from cellapp.run.overview import planned_stops

if TYPE_CHECKING:
    from cellapp.profile import Profile
    from cellapp.reporting.charts import Chart
    from cellapp.results import PlanDesignResult, PlannedStop


@dataclass(frozen=True)
class PlanSection:
    """What the page shows of a plan; sentences and tables only of one that was designed."""

    figures: tuple[CaptionedFigure, ...]
    tables: tuple[Table, ...] = ()
    sentences: tuple[str, ...] = ()


def plan_section(run: RunFile) -> PlanSection | None:
    """The section of a run with a plan; None for imported readings."""
    from cellapp.reporting.chart_figure import chart_figure

    stops, design = planned_stops(run).stops, read_plan_design(run)
    if not stops:
        return None
    charts = plan_charts(run.profile, stops, design)
    figures = tuple(chart_figure(f"plan{number}", chart) for number, chart in enumerate(charts, start=1))
    if design is None:
        return PlanSection(figures)
    return PlanSection(figures)


def plan_charts(profile: Profile, stops: Sequence[PlannedStop], design: PlanDesignResult | None) -> Iterator[Chart]:
    """The cell from above and from the tracker, joint ranges, and what is known of the design."""
    from cellapp.reporting.charts_map import cell_map_chart

    yield cell_map_chart(profile, stops)
    yield cell_map_chart(profile, stops, "tracker")
    yield from design_charts_of(profile, stops, design)


def design_charts_of(
    profile: Profile, stops: Sequence[PlannedStop], design: PlanDesignResult | None
) -> tuple[Chart, ...]:
    """Joint ranges, and what is known of the design."""
    from cellapp.reporting.charts_plan import coverage_charts, design_charts

    known = () if design is None else design_charts(design)
    return (*known, *coverage_charts(profile, stops))
