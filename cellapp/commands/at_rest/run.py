"""The verb ``at-rest``: record that a person saw an arm at rest which counted as moving."""

from __future__ import annotations

from cellapp.cell.run import RunFile
from cellapp.cell.run.unseen_arms import BY_PERSON, note_at_rest
from cellapp.commands.at_rest.request import AtRestRequest
from cellapp.commands.at_rest.result import AtRestResult
from cellapp.commands.record import Work


def run(request: AtRestRequest, work: Work) -> AtRestResult:
    """Record that the arm was seen at rest."""
    with RunFile.open(request.folder, write=True) as opened:
        counted = note_at_rest(opened, request.arm, BY_PERSON)
    return AtRestResult(run=str(request.folder), arm=request.arm, counted_as_moving=counted)
