"""The result of ``greet`` for people."""

from __future__ import annotations

from cellapp.commands.record import Request, View
from cellapp.commands.view.charts import Axis, Chart, series
from cellapp.commands.view.table import Column, Table, number_column
from tests.commands.toys.greet.result import GreetResult


def view(result: GreetResult, request: Request | None = None) -> View:
    """Whom, and how often."""
    rows = tuple((arm, result.times) for arm in result.arms)
    times = [float(result.times)] * len(result.arms)
    drawn = (series("greetings", range(1, len(times) + 1), times, "bars"),)
    chart = Chart("Greetings", Axis("arm"), Axis("times"), drawn, "Everybody is greeted as often.")
    table = Table("Greeted", (Column("arm"), number_column("times", "d")), rows)
    return View((table, chart, "hello to all of them"))
