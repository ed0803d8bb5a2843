"""The verb ``greet``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cellapp.cell.run import RunFile
from cellapp.commands.record import Asked, Request, RunFolder, Verb, View, Work
from cellapp.commands.view.charts import Axis, Chart, series
from cellapp.commands.view.table import Column, Table
from cellapp.ground.results import Result


class GreetRequest(Request):
    """Say hello to the arms of a run."""

    folder: RunFolder
    times: Annotated[int, Field(ge=1, le=3), Asked("How often.", "N", label="times")] = 1


VERB = Verb("greet", GreetRequest, chapter="commands", question="Greet the arms?")


class GreetResult(Result, schema="toy-greet"):
    """``greet``: whom it greeted, and how often."""

    arms: tuple[str, ...]
    times: int


def run(request: GreetRequest, work: Work) -> GreetResult:
    """Find the arms."""
    with RunFile.open(request.folder) as opened:
        return GreetResult(arms=tuple(opened.profile.arms), times=request.times)


def view(result: GreetResult, request: Request | None = None) -> View:
    """Whom, and how often."""
    rows = tuple((arm, result.times) for arm in result.arms)
    times = [float(result.times)] * len(result.arms)
    drawn = (series("greetings", range(1, len(times) + 1), times, "points"),)
    chart = Chart("Greetings", Axis("arm"), Axis("times"), drawn, "Everybody is greeted as often.")
    table = Table("Greeted", (Column("arm"), Column("times", "d")), rows)
    return View((table, chart, "hello to all of them"))
