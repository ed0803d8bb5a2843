"""Request of the verb ``replay``."""

from __future__ import annotations

from typing import Annotated

from cellapp.commands.fields import RunFolder
from cellapp.commands.record import Asked, Request, Verb


class ReplayRequest(Request):
    """Play the collecting of a run back: the same events, the same running model; nothing moves, nothing is written."""

    folder: RunFolder
    speed: Annotated[float, Asked("Times the recorded pace, from 1 to 100.", "X")] = 10.0

    def job_name(self) -> str:
        return f"replay x{self.speed:g}"


VERB = Verb("replay", ReplayRequest, chapter="terminal")
