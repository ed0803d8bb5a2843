"""The verb ``demo``: everything, on the simulated cell."""

from __future__ import annotations

from cellapp.cell.profile.starters import FOLDER, TWIN_SMALL, write_starter
from cellapp.commands.demo.request import DemoRequest
from cellapp.commands.plan.run import default_folder
from cellapp.commands.record import Work
from cellapp.commands.run import run as whole
from cellapp.commands.run.request import RunRequest
from cellapp.commands.run.result import WholeRunResult
from cellapp.ground.starters import TWIN

_SWEEPS = 20
"""Stops of the demonstration in motion, each with a sweep of every arm."""


def run(request: DemoRequest, work: Work) -> WholeRunResult:
    """Write the profile if there is none, and run everything."""
    name = TWIN if request.full else TWIN_SMALL
    profile = request.folder / FOLDER / f"{name}.yaml"
    if profile.is_file():
        work.say(f"{profile} exists already and is used as it is")
    else:
        write_starter(name, request.folder)
        work.say(f"written: {profile}")
    sweeps = _SWEEPS if request.sweeps else None
    return whole.run(RunRequest(profile=profile, folder=request.folder / default_folder(name), sweeps=sweeps), work)
