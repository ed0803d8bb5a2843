"""Request of the verb ``check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from cellapp.commands.record import Asked, Request, RunFolder, Stored, Verb

STOPS = 20
FEWEST_STOPS = 4
"""Least stops of an arm: fewer do not tell a motion of its base from that of a joint."""


class CheckRequest(Request):
    """Measure a few stops: does the calibration still hold, what has moved or changed, how much accuracy is left."""

    folder: RunFolder
    stops: Annotated[
        int,
        Field(ge=FEWEST_STOPS, le=1000),
        Asked("Stops at most; fewer where that is enough.", "N", label="stops at most", hint="of all arms together"),
    ] = STOPS
    strict: Annotated[bool, Asked("Exit code 1 also if the model was out of date before the check.")] = False
    simulated_plant: Annotated[
        Path | None,
        Asked(
            "Simulated cells only: the hidden physics of this profile, for this check alone.",
            "PROFILE",
            label="simulate plant of",
            simulated=True,
            suffixes=(".yaml", ".yml"),
        ),
    ] = None


VERB = Verb(
    "check",
    CheckRequest,
    chapter="check",
    moves_arms=True,
    question="Check the calibration?",
    stored=(Stored("check", "no check is", ("check",)),),
)
