"""The verb ``demo``: everything, on the simulated cell."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.cell.profile.starters import FOLDER, TWIN_SMALL, write_starter
from cellapp.commands.plan.run import default_folder
from cellapp.commands.record import Asked, Request, Verb, Work
from cellapp.commands.run.request import RunRequest
from cellapp.commands.run.run import WholeRunResult
from cellapp.commands.run.run import run as whole
from cellapp.commands.run.run import view as view
from cellapp.ground.starters import TWIN


class DemoRequest(Request):
    """Try the program without hardware: write the simulated cell's profile, run everything, report."""

    folder: Annotated[
        Path, Asked("Profile and run go into FOLDER/profiles and FOLDER/logs.", "FOLDER", argument=True)
    ] = Path()
    full: Annotated[bool, Asked("All 400 stops instead of 80.")] = False
    sweeps: Annotated[bool, Asked("20 stops, and a sweep of each arm about every one: calibration in motion.")] = False


VERB = Verb("demo", DemoRequest, chapter="tutorial")


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
    return whole(RunRequest(profile=profile, folder=request.folder / default_folder(name), sweeps=sweeps), work)
