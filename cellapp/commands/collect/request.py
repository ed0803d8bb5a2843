"""What ``collect`` is asked for."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import model_validator

from cellapp.commands.fields import RunFolder
from cellapp.commands.record import Asked, Request, Verb


class CollectRequest(Request):
    """Drive the planned stops and measure; every stop is committed before the next move."""

    folder: RunFolder
    resume: Annotated[bool, Asked("Continue a run that was interrupted.")] = False
    accept_drift: Annotated[bool, Asked("Count drift from new reference measurements on.")] = False
    again: Annotated[
        str | None,
        Asked(
            "Stops to measure again, as 3,7-9, numbered as 'cellapp show DIR collection' lists them; their earlier"
            " readings are kept beside.",
            "LIST",
        ),
    ] = None

    def job_name(self) -> str:
        return "collect again" if self.again is not None else ""

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        if self.again is not None and self.resume:
            raise ValueError("--again and --resume do not go together; give one of them")
        return self


VERB = Verb("collect", CollectRequest, chapter="tutorial", moves_arms=True)
