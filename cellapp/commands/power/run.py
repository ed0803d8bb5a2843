"""The verb ``power``: make blind trials of a run's planned stops and store the result in the run."""

from __future__ import annotations

from cellapp.cell.planning.check import required_plan
from cellapp.cell.planning.planned_stops import read_planned_stops
from cellapp.cell.run import RunFile
from cellapp.commands.power.request import PowerRequest
from cellapp.commands.record import Work
from cellapp.commands.trials import skeleton
from cellapp.commands.trials.power.result import PowerResult
from cellapp.commands.trials.power.rounds import power_of
from cellapp.commands.trials.power.trial import PlannedCell
from cellapp.ground.scale.executor import Resources
from cellapp.ground.time_limit import TimeLimit

POWER_RESULT = "plan-power"
"""Name of the document in the run with the result."""


def run(request: PowerRequest, work: Work) -> PowerResult:
    """Try the plan of a run on all cores; store the result in the run."""
    limit = TimeLimit.from_now(request.minutes)
    with RunFile.open(request.folder, write=True) as opened:
        required_plan(opened)
        planned = PlannedCell.of(opened.profile, read_planned_stops(opened))
        trials = skeleton.Work(Resources(), work.listener, work.control)
        result = power_of(planned, request.trials, request.seed, trials, limit)
        opened.write_result(POWER_RESULT, result.to_json())
        return result


def stored_power(run: RunFile) -> PowerResult | None:
    """Return the stored result of a run; None if its plan was not tried."""
    text = run.read_result(POWER_RESULT)
    return None if text is None else PowerResult.from_json(text, str(run.folder))
