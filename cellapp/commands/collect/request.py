"""What ``collect`` is asked for."""

from __future__ import annotations

from typing import Annotated

from cellapp.commands.fields import RunFolder
from cellapp.commands.record import Asked, Request, Verb


class CollectRequest(Request):
    """Drive the planned stops and measure; every stop is committed before the next move."""

    folder: RunFolder
    resume: Annotated[bool, Asked("Continue a run that was interrupted.")] = False
    accept_drift: Annotated[bool, Asked("Count drift from new reference measurements on.")] = False


VERB = Verb("collect", CollectRequest, chapter="tutorial", moves_arms=True)
