"""Request of the verb ``runs``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.record import Asked, Request, Verb


class RunsRequest(Request):
    """List every run below a folder, newest first: state, accuracy, what comes next, what can be resumed."""

    folder: Annotated[Path | None, Asked("A folder that holds runs; logs if not given.", "FOLDER", argument=True)] = (
        None
    )
    history: Annotated[
        str | None, Asked("One arm over its runs, what moved since the first: its serial number, or its name.", "ARM")
    ] = None


VERB = Verb("runs", RunsRequest, chapter="commands")
