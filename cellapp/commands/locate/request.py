"""Request of the verb ``locate``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cellapp.commands.record import Asked, Request, RunFolder, Stored, Verb

_POSE = "x,y,z,r,p,y in m, deg"


class LocateRequest(Request):
    """After the tracker was moved: measure a few points, so that the calibration holds from where it stands now."""

    folder: RunFolder
    points: Annotated[int, Field(ge=3), Asked("Points of all arms together.", "N", label="points")] = 4
    tracker_pose: Annotated[
        str | None,
        Asked(
            "Where the tracker stands now in the cell, to about 50 mm and 1 deg: m, and roll, pitch, yaw in deg.",
            "X,Y,Z,R,P,Y",
            label="tracker about at",
            hint=f"{_POSE}; empty: as before",
        ),
    ] = None
    simulated_pose: Annotated[
        str | None,
        Asked(
            "Simulated cells only: put the tracker there first.",
            "X,Y,Z,R,P,Y",
            label="put it first to",
            hint=f"{_POSE}; may be empty",
            simulated=True,
        ),
    ] = None


VERB = Verb(
    "locate",
    LocateRequest,
    chapter="check",
    moves_arms=True,
    question="Locate the tracker?",
    checks="location",
    stored=(Stored("location", "no station of the tracker is", ("locate",)),),
)
