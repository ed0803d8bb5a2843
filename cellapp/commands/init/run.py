"""The verb ``init``: write a profile as a starting point."""

from __future__ import annotations

from cellapp.cell.profile.starters import write_starter
from cellapp.commands.init.answers import write_answers
from cellapp.commands.init.own_data import OwnData, write_own_data
from cellapp.commands.init.request import InitRequest
from cellapp.commands.init.result import InitResult
from cellapp.commands.record import Work
from cellapp.ground.starters import TWIN


def run(request: InitRequest, work: Work) -> InitResult:
    """Write the profile; ask for missing data of recorded readings."""
    if request.readings is not None:
        given = OwnData(
            request.readings,
            request.arm or "",
            request.modified,
            request.angles or "",
            request.lengths or "",
            request.name or "",
        )
        own = write_own_data(given, request.folder, work.choose, work.outputs)
        if own.readings is None:
            joints, points = str(request.readings), str(request.readings) if own.points_beside else None
            return InitResult(profile=str(own.profile), notes=own.notes, joints=joints, points=points)
        return InitResult(profile=str(own.profile), notes=own.notes, readings=str(own.readings))
    if request.answers is not None:
        written = write_answers(request.answers, request.folder)
        return InitResult(profile=str(written.path), notes=written.notes)
    starter = TWIN if request.starter is None else request.starter
    return InitResult(profile=str(write_starter(starter, request.folder)))
