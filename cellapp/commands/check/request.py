"""Request of the verb ``check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from cellapp.commands.record import Asked, Request, RunFolder, Stored, Verb

STOPS = 20
STOPS_TO_LOCATE = 4
FEWEST_STOPS = 4
"""Least stops of an arm: fewer do not tell a motion of its base from that of a joint."""
_POSE = "x,y,z,r,p,y in m, deg"


class CheckRequest(Request):
    """Measure a few stops: does the calibration still hold, what has moved or changed, how much accuracy is left.

    With --tracker-moved, the tracker is located, so that the calibration holds from where it stands now.
    """

    folder: RunFolder
    stops: Annotated[
        int | None,
        Field(ge=FEWEST_STOPS, le=1000),
        Asked(
            f"Stops at most; fewer where that is enough. {STOPS} if left out; to locate the tracker {STOPS_TO_LOCATE}.",
            "N",
            label="stops at most",
            hint="of all arms together; may be empty",
        ),
    ] = None
    tracker_moved: Annotated[bool, Asked("The tracker was moved on purpose: measure where it stands now.")] = False
    tracker_pose: Annotated[
        str | None,
        Asked(
            "where it stands in the cell, to about 50 mm and 1 deg: m, and roll, pitch, yaw in deg.",
            "X,Y,Z,R,P,Y",
            label="tracker about at",
            hint=f"{_POSE}; empty: as before",
            of="tracker_moved",
        ),
    ] = None
    simulated_pose: Annotated[
        str | None,
        Asked(
            "in simulated cells only: put the tracker there first.",
            "X,Y,Z,R,P,Y",
            label="put it first to",
            hint=f"{_POSE}; may be empty",
            simulated=True,
            of="tracker_moved",
        ),
    ] = None
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

    @property
    def most_stops(self) -> int:
        """Number of stops at most."""
        return self.stops or (STOPS_TO_LOCATE if self.tracker_moved else STOPS)

    def job_name(self) -> str:
        return "locate" if self.tracker_moved else ""

    @model_validator(mode="after")
    def _of_a_moved_tracker(self) -> Self:
        """Refuse words that only a check knows where the tracker is located."""
        if self.tracker_moved and (self.strict or self.simulated_plant is not None):
            raise ValueError("--strict and --simulated-plant belong to a check without --tracker-moved")
        return self


VERB = Verb(
    "check",
    CheckRequest,
    chapter="check",
    moves_arms=True,
    question="Measure a few stops?",
    stored=(
        Stored("check", "no check is", ("check",)),
        Stored("location", "no station of the tracker is", ("locate",), "check --tracker-moved", "location_view"),
    ),
)
