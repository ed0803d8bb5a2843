"""Request of the verb ``at-rest``."""

from __future__ import annotations

from typing import Annotated

from cellapp.commands.fields import RunFolder
from cellapp.commands.record import Asked, Request, Verb


class AtRestRequest(Request):
    """Say that you have seen an arm at rest that a run counts as moving since its stop was not confirmed."""

    folder: RunFolder
    arm: Annotated[str, Asked("The arm, as the profile names it.", "ARM", argument=True)]


VERB = Verb("at-rest", AtRestRequest, chapter="faults")
