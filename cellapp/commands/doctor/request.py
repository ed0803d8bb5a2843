"""What ``doctor`` is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.fields import ProfilePath
from cellapp.commands.record import Asked, Request, Verb


class DoctorRequest(Request):
    """What is reachable, what is missing, what would be refused; nothing moves."""

    profile: ProfilePath
    reference_nests: Annotated[
        Path | None, Asked("Say how well these reference nests tie tracker stations, at the arms at home.", "FILE")
    ] = None
    cell: Annotated[bool, Asked("First print what the profile says of the cell.")] = False


VERB = Verb("doctor", DoctorRequest, chapter="cell")
