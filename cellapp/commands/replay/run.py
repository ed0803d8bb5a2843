"""The verb ``replay``: play back what a run recorded."""

from __future__ import annotations

from cellapp.cell.driving.records import ReplayResult
from cellapp.cell.driving.replay import replay_run
from cellapp.cell.run import RunFile
from cellapp.commands.record import Work
from cellapp.commands.replay.request import ReplayRequest


def run(request: ReplayRequest, work: Work) -> ReplayResult:
    """Play the run back."""
    with RunFile.open(request.folder) as opened:
        return replay_run(opened, work.listener, work.control, speed=request.speed)
