"""What ``doctor`` is asked for."""

from __future__ import annotations

from typing import Annotated

from cellapp.commands.fields import ProfilePath
from cellapp.commands.record import Asked, Request, Verb


class DoctorRequest(Request):
    """What is reachable, what is missing, what would be refused; nothing moves."""

    profile: ProfilePath
    cell: Annotated[bool, Asked("First print what the profile says of the cell.")] = False


VERB = Verb("doctor", DoctorRequest, chapter="cell")
