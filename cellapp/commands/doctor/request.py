"""Request of the verb ``doctor``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.record import Asked, ProfilePath, Request, Verb
from cellapp.ground.outputs import Writes


class DoctorRequest(Request):
    """What is reachable, what is missing, what would be refused; nothing moves."""

    profile: ProfilePath
    cell: Annotated[bool, Asked("First print what the profile says of the cell.")] = False
    explain: Annotated[bool, Asked("First print every value in force and where it comes from.")] = False
    controllers: Annotated[
        Path | None,
        Asked(
            "Write the controllers' own calibrations here, for arms.*.factory.",
            "DIR",
            label="calibrations into",
            hint="empty: not written",
            writes=Writes.FOLDER,
        ),
    ] = None

    bundle: Annotated[
        Path | None,
        Asked(
            "Pack versions, profile, findings, a run's log and states of the controllers for a report to the authors.",
            "FILE",
            label="report in file",
            hint="empty: none",
            writes=Writes.FILE,
        ),
    ] = None
    run_folder: Annotated[
        Path | None,
        Asked(
            "run whose log is packed; left out, the newest of this cell below logs.",
            "DIR",
            option="--run",
            label="log of run",
            hint="empty: the newest one",
            of="bundle",
        ),
    ] = None


VERB = Verb("doctor", DoctorRequest, chapter="cell")
