"""What ``greet`` is asked for."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cellapp.commands.fields import RunFolder
from cellapp.commands.record import Asked, Request, Verb


class GreetRequest(Request):
    """Say hello to the arms of a run."""

    folder: RunFolder
    times: Annotated[int, Field(ge=1, le=3), Asked("How often.", "N", label="times")] = 1


VERB = Verb("greet", GreetRequest, chapter="commands", question="Greet the arms?")
