"""Request of the verb ``compare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.record import Asked, Request, Verb


class CompareRequest(Request):
    """Compare two runs: profile, parameters, held-out errors, effects, inter-base transform, verification."""

    first: Annotated[Path, Asked("Folder of the run that the other is compared with.", "DIR", argument=True)]
    second: Annotated[Path, Asked("Folder of the other run.", "DIR", argument=True)]


VERB = Verb("compare", CompareRequest, chapter="commands")
