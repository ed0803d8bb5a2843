"""Request of the verb ``power``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cellapp.commands.fields import RunFolder
from cellapp.commands.record import Asked, Request, Verb

FEWEST_TRIALS, TRIALS = 8, 16
"""Least and usual number of trials for each effect and arm."""


MINUTES = 10.0
"""Usual time limit of the trials [min]."""


class PowerRequest(Request):
    """Before measuring: which effects of which size a plan would have named, from blind trials of its stops.

    Takes minutes on all cores. 'cellapp trials power PROFILE' does the same for a profile, without a run.
    """

    folder: RunFolder
    trials: Annotated[
        int,
        Field(ge=FEWEST_TRIALS, le=400),
        Asked("Trials of each effect and arm.", "N", label="trials of each effect"),
    ] = TRIALS
    minutes: Annotated[
        float,
        Field(gt=0.0, le=1e5),
        Asked("Time for the trials; what fits is shared among the effects.", "N", label="minutes"),
    ] = MINUTES
    seed: Annotated[
        int, Field(ge=0), Asked("Draws laws, true geometry and noise.", "N", label="seed", hint="0 or more")
    ] = 0


VERB = Verb("power", PowerRequest, chapter="planning", question="Which effects would be named?")
