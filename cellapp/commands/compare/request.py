"""Request of the verb ``compare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.record import Asked, Request, Verb


class CompareRequest(Request):
    """Compare two runs: profile, parameters, held-out errors, effects, inter-base transform, verification.

    More than two are compared as by 'fleet', in the order in which they are given.
    """

    folders: Annotated[
        tuple[Path, ...],
        Asked("Folders of two runs or more; the first is compared with.", "DIR DIR...", argument=True),
    ]


VERB = Verb("compare", CompareRequest, chapter="commands")
