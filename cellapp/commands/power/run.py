"""The verb ``power``: blind trials of the planned stops of a run. The run keeps the result."""

from __future__ import annotations

from cellapp.cell.planning.check import required_plan
from cellapp.cell.planning.stored_stops import read_planned_stops
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
"""Name of the document in which a run keeps the result."""


def run(request: PowerRequest, work: Work) -> PowerResult:
    """Try the plan of a run on all cores, and keep the result in the run."""
    limit = TimeLimit.from_now(request.minutes)
    with RunFile.open(request.folder, write=True) as opened:
        required_plan(opened)
        planned = PlannedCell.of(opened.profile, read_planned_stops(opened))
        trials = skeleton.Work(Resources(), work.listener, work.control)
        result = power_of(planned, request.trials, request.seed, trials, limit)
        opened.write_result(POWER_RESULT, result.to_json())
        return result


def stored_power(run: RunFile) -> PowerResult | None:
    """Return what the plan of a run can name, if it was tried."""
    text = run.read_result(POWER_RESULT)
    return None if text is None else PowerResult.from_json(text, str(run.folder))
