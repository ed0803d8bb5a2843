"""The verb ``runs``: list a folder of runs. It only reads."""

from __future__ import annotations

from cellapp.commands.record import Work
from cellapp.commands.runs import history
from cellapp.commands.runs.request import RunsRequest
from cellapp.commands.runs.result import RunsResult


def run(request: RunsRequest, work: Work) -> RunsResult:
    """List the runs."""
    return history.list_runs(request.folder)
