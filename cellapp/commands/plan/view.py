"""The results of ``plan`` as tables and sentences: a plan that was made, a check, a forecast, a view, stored stops."""

from __future__ import annotations

import math

from cellapp.cell.driving.records import PlanResult
from cellapp.cell.planning.records import PlanCheckResult, PlanForecastResult, ViewResult
from cellapp.commands.plan.check_view import (
    check_sentences,
    design_sentences,
    design_tables,
    forecast_sentences,
    forecast_tables,
    load_sentences,
    plan_lines,
    plan_result_tables,
    sweep_sentences,
    sweep_tables,
    view_sentences,
    view_tables,
)
from cellapp.commands.plan.result import StopsResult
from cellapp.commands.record import Request, View
from cellapp.commands.view.table import Column, Table, number_column

_DEG = ".2f"
"""Number format of joint angles in degrees."""


def view(
    result: PlanResult | PlanCheckResult | PlanForecastResult | ViewResult | StopsResult, request: Request | None = None
) -> View:
    """Show what was planned, refused, predicted or seen; a check fails if the gate refuses something."""
    match result:
        case PlanResult():
            tables = (*plan_result_tables(result), *sweep_tables(result.sweeps))
            parts: tuple[Table | str, ...] = (*tables, *plan_lines(result), *sweep_sentences(result.sweeps))
            return View(parts, held="; ".join(result.notes))
        case PlanCheckResult():
            verdict, *offences = check_sentences(result)
            return View((*offences, verdict), held=verdict) if result.is_safe else View(offences, (verdict,), "plan")
        case PlanForecastResult():
            return View((*forecast_tables(result), *forecast_sentences(result)))
        case ViewResult():
            return View((*view_tables(result), *view_sentences(result)))
    planned = () if result.stops else ("no stops are planned",)
    design = result.design
    told: tuple[Table | str, ...] = () if design is None else (*design_tables(design), *design_sentences(design))
    swept: tuple[Table | str, ...] = (*sweep_tables(result.sweeps), *sweep_sentences(result.sweeps))
    return View((*plan_tables(result), *planned, *told, *load_sentences(result.loads), *swept))


def plan_tables(stops: StopsResult) -> list[Table]:
    """Show joint angles [deg] of every planned stop, one table for each arm."""
    tables = []
    for name in stops.stops[0].q if stops.stops else ():
        joints = len(stops.stops[0].q[name])
        columns = (
            number_column("stop", "d"),
            Column("measured"),
            *(number_column(f"q{joint}", _DEG, "deg") for joint in range(1, joints + 1)),
        )
        rows = tuple(
            (stop.configuration, "yes" if stop.measured else "no", *map(math.degrees, stop.q[name]))
            for stop in stops.stops
        )
        tables.append(Table(f"Arm {name}: planned stops", columns, rows))
    return tables
