"""Request of the verb ``discover``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cellapp.commands.record import Asked, Request, RunFolder, Stored, Verb


class DiscoverRequest(Request):
    """Find where model and measurement disagree, name the missing effect, add it, show the gap shrink."""

    folder: RunFolder
    propose: Annotated[
        int | None, Field(ge=1, le=1000), Asked("Plan N further stops that best resolve what is open.", "N")
    ] = None

    def job_name(self) -> str:
        return "" if self.propose is None else "propose"


VERB = Verb(
    "discover", DiscoverRequest, chapter="discovery", stored=(Stored("discovery", "no discovery is", ("discover",)),)
)
