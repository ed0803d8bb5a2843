"""What ``import`` is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.fields import NewRun, ProfilePath
from cellapp.commands.record import Asked, Request, Verb


class ImportRequest(Request):
    """Make a run from readings that were measured elsewhere."""

    profile: ProfilePath
    csv: Annotated[Path, Asked("Readings; 'cellapp docs files' has the columns.", "CSV", argument=True)]
    folder: NewRun
    in_order: Annotated[
        bool,
        Asked("Rows stand in the order of measurement (with time_s: by time); derive missing approach and step."),
    ] = False
    distances: Annotated[Path | None, Asked("Known distances between points in sockets.", "FILE")] = None


VERB = Verb("import", ImportRequest, chapter="readings")
