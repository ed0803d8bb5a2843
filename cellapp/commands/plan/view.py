"""The results of ``plan`` as tables and sentences: a plan that was made, a check, a forecast, a view, stored stops."""

from __future__ import annotations

from cellapp.cell.driving.records import PlanResult
from cellapp.cell.planning.design_records import ViewResult
from cellapp.cell.planning.records import PlanCheckResult, PlanForecastResult
from cellapp.commands.plan.check_view import check_sentences, forecast_sentences, forecast_tables
from cellapp.commands.plan.design_view import design_sentences, design_tables, plan_lines, plan_result_tables
from cellapp.commands.plan.result import StopsResult
from cellapp.commands.plan.tracker_view import view_sentences, view_tables
from cellapp.commands.record import Request, View
from cellapp.commands.show.tables import plan_tables
from cellapp.commands.view.table import Table


def view(
    result: PlanResult | PlanCheckResult | PlanForecastResult | ViewResult | StopsResult, request: Request | None = None
) -> View:
    """What was planned, refused, foreseen or seen; a check fails where the safety gate refuses something."""
    match result:
        case PlanResult():
            return View((*plan_result_tables(result), *plan_lines(result)))
        case PlanCheckResult():
            verdict, *offences = check_sentences(result)
            return View((*offences, verdict)) if result.is_safe else View(offences, (verdict,), "plan")
        case PlanForecastResult():
            return View((*forecast_tables(result), *forecast_sentences(result)))
        case ViewResult():
            return View((*view_tables(result), *view_sentences(result)))
    planned = () if result.stops else ("no stops are planned",)
    design = result.design
    told: tuple[Table | str, ...] = () if design is None else (*design_tables(design), *design_sentences(design))
    return View((*plan_tables(result), *planned, *told))
