"""Request of the verb ``run``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from cellapp.commands.record import Asked, ProfilePath, Request, Verb


class RunRequest(Request):
    """Everything, unattended: plan, collect, calibrate, discover, compensate, verify, report."""

    profile: ProfilePath
    folder: Annotated[
        Path | None, Asked("Folder of the new run; else a new one below logs/.", "DIR", option="--run")
    ] = None
    sweeps: Annotated[
        int | None,
        Field(ge=1, le=1000),
        Asked("Measure N stops only, and record a sweep of every arm about each.", "N"),
    ] = None


VERB = Verb("run", RunRequest, chapter="tutorial", moves_arms=True)
