"""The verb ``greet``."""

from __future__ import annotations

from cellapp.cell.run import RunFile
from cellapp.commands.record import Work
from tests.commands.toys.greet.request import GreetRequest
from tests.commands.toys.greet.result import GreetResult


def run(request: GreetRequest, work: Work) -> GreetResult:
    """Find the arms."""
    with RunFile.open(request.folder) as opened:
        return GreetResult(arms=tuple(opened.profile.arms), times=request.times)
