"""The verb ``runs``: list a folder of runs, or one arm over them. It only reads."""

from __future__ import annotations

from cellapp.commands.record import Work
from cellapp.commands.runs import history
from cellapp.commands.runs.arm_history import arm_history
from cellapp.commands.runs.request import RunsRequest
from cellapp.commands.runs.result import ArmHistory, RunsResult


def run(request: RunsRequest, work: Work) -> RunsResult | ArmHistory:
    """List the runs, or those of one arm."""
    if request.history is not None:
        return arm_history(request.history, request.folder)
    return history.list_runs(request.folder)
