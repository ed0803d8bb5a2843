"""Request of the verb ``recalibrate``."""

from __future__ import annotations

from typing import Annotated

from cellapp.commands.fields import Jobs, RunFolders, Scheduler
from cellapp.commands.record import Asked, Request, Verb


class RecalibrateRequest(Request):
    """Calibrate and discover again every run that is out of date; each run keeps its results."""

    folders: RunFolders
    again: Annotated[bool, Asked("Compute again also what still holds.")] = False
    calibration_only: Annotated[bool, Asked("Search no effects.")] = False
    jobs: Jobs = None
    scheduler: Scheduler = None


VERB = Verb("recalibrate", RecalibrateRequest, chapter="scale")
