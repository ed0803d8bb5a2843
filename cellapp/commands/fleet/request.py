"""Request of the verb ``fleet``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.fields import RunFolders
from cellapp.commands.record import Asked, Request, Verb
from cellapp.ground.outputs import Writes


class FleetRequest(Request):
    """Follow every arm over its runs: parameters, effects, errors, trends to the tolerance."""

    folders: RunFolders
    page: Annotated[Path | None, Asked("Write one self-contained HTML page to FILE.", "FILE", writes=Writes.FILE)] = (
        None
    )
    strict: Annotated[bool, Asked("Exit code 1 if any arm is beyond its tolerance or has changed.")] = False


VERB = Verb("fleet", FleetRequest, chapter="fleet")
