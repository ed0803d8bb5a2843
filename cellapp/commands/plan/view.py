"""The results of ``plan`` as tables and sentences: a plan that was made, a check, a forecast, stored stops."""

from __future__ import annotations

import math

from cellapp.cell.planning.records import PlanCheckResult, PlanForecastResult
from cellapp.cell.run import RunFile
from cellapp.commands.plan.charts import cell_map_chart
from cellapp.commands.plan.check_view import (
    check_sentences,
    design_parts,
    forecast_sentences,
    forecast_tables,
    plan_lines,
)
from cellapp.commands.plan.result import PlanResult, StopsResult
from cellapp.commands.plan.run import planned_stops
from cellapp.commands.record import Request, View
from cellapp.commands.view.parts import Section
from cellapp.commands.view.table import Table, table_of_cells

_DEG = ".2f"
"""Number format of joint angles in degrees."""


def view(
    result: PlanResult | PlanCheckResult | PlanForecastResult | StopsResult, request: Request | None = None
) -> View:
    """Show what was planned, refused or predicted; a check fails if the gate refuses something."""
    match result:
        case PlanResult():
            return View((*design_parts(result), *plan_lines(result)), held="; ".join(result.notes))
        case PlanCheckResult():
            verdict, *offences = check_sentences(result)
            return View((*offences, verdict), held=verdict) if result.is_safe else View(offences, (verdict,), "plan")
        case PlanForecastResult():
            return View((*forecast_tables(result), *forecast_sentences(result)))
    planned = () if result.stops else ("no stops are planned",)
    return View((*plan_tables(result), *planned, *design_parts(result)))


def plan_tables(stops: StopsResult) -> list[Table]:
    """Show joint angles [deg] of every planned stop, one table for each arm."""
    tables = []
    for name in stops.stops[0].q if stops.stops else ():
        joints = len(stops.stops[0].q[name])
        rows = (
            (stop.configuration + 1, "yes" if stop.measured else "no", *map(math.degrees, stop.q[name]))
            for stop in stops.stops
        )
        angles = ((f"q{joint}", _DEG, "deg") for joint in range(1, joints + 1))
        tables.append(table_of_cells(f"Arm {name}: planned stops", rows, ("stop", "d"), "measured", *angles))
    return tables


def plan_section(run: RunFile) -> Section | None:
    """Build the section of a run with a plan; None for imported readings."""
    planned = planned_stops(run)
    if not planned.stops:
        return None
    about = "The map shows the planned stops in the cell frame, with obstacles."
    if planned.design is not None:
        about += (
            " The stops were chosen to tell most about geometry and effects. Expected errors follow from the tracker's"
            " noise, with geometry and all these effects unknown; beside them are those of random plans of the same"
            " size. 'cellapp docs planning' explains them."
        )
    message = "Where the planned stops are, and what limits them."
    return Section([cell_map_chart(run.profile, planned.stops), *design_parts(planned)], message=message, about=about)
