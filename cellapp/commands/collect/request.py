"""Request of the verb ``collect``."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import model_validator

from cellapp.commands.record import Asked, Request, RunFolder, Verb


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

    payload: Annotated[
        str | None,
        Asked(
            "What each arm carries now [kg], as left=5,right=3: it hangs, and its controller is set to it. For a plan"
            " with several loads, where nobody can be asked.",
            "LIST",
        ),
    ] = None

    @property
    def payloads(self) -> dict[str, float] | None:
        """What each arm is said to carry [kg]; None if nothing is said."""
        return None if self.payload is None else _loads(self.payload)

    def job_name(self) -> str:
        return "collect again" if self.again is not None else ""

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        if self.again is not None and self.resume:
            raise ValueError("--again and --resume do not go together; give one of them")
        if self.payload is not None:
            _loads(self.payload)
        return self


def _loads(text: str) -> dict[str, float]:
    """Parse the load [kg] of each arm. Raises ``ValueError``."""
    found: dict[str, float] = {}
    for part in text.split(","):
        name, _, number = (piece.strip() for piece in part.partition("="))
        if name in found:
            raise ValueError(f"--payload: arm {name} is there twice, with {found[name]:g} and {number} kg; say which")
        try:
            found[name] = float(number)
        except ValueError:
            raise ValueError(f"--payload: expected arm=kg, as left=5,right=3, got '{text}'") from None
        if not math.isfinite(found[name]):
            raise ValueError(f"--payload: expected a number of kg for arm {name}, got '{number}'")
    return found


VERB = Verb("collect", CollectRequest, chapter="tutorial", moves_arms=True)
