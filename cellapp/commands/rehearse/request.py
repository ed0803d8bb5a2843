"""Request of the verb ``rehearse``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.cell.driving.rehearsal_rungs import RungName
from cellapp.commands.record import Asked, ProfilePath, Request, Verb


class RehearseRequest(Request):
    """Drive a plan step by step before it is collected: controllers in simulation, one arm, ten stops, both arms."""

    profile: ProfilePath
    run_folder: Annotated[
        Path | None,
        Asked(
            "Run whose plan is driven; left out, PROFILE-rehearsal beside the profile, planned if it is not there.",
            "DIR",
            option="--run",
        ),
    ] = None
    rung: Annotated[
        RungName | None, Asked("Step to rehearse; left out, the first one that is missing.", "RUNG", label="step")
    ] = None
    arm: Annotated[str | None, Asked("Arm of a step with one arm; left out, the first one.", "NAME", label="arm")] = (
        None
    )


VERB = Verb("rehearse", RehearseRequest, chapter="cell", moves_arms=True, question="Rehearse?", checks="rehearsal")
