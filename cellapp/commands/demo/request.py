"""Request of the verb ``demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.record import Asked, Request, Verb


class DemoRequest(Request):
    """Try the program without hardware: write the simulated cell's profile, run everything, report."""

    folder: Annotated[
        Path, Asked("Profile and run go into FOLDER/profiles and FOLDER/logs.", "FOLDER", argument=True)
    ] = Path()
    full: Annotated[bool, Asked("All 400 stops instead of 80.")] = False
    sweeps: Annotated[bool, Asked("20 stops, and a sweep of each arm about every one: calibration in motion.")] = False


VERB = Verb("demo", DemoRequest, chapter="tutorial")
