"""Request of the verb ``emulate``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cellapp.commands.fields import ProfilePath
from cellapp.commands.record import Asked, Request, Verb


class EmulateRequest(Request):
    """Emulate this cell's controllers and, behind a bridge, its tracker, on loopback until interrupted."""

    profile: ProfilePath
    pace: Annotated[float, Field(ge=0.1, le=1000.0), Asked("Simulated seconds for each real one.", "X")] = 1.0
    lost_beams: Annotated[
        float, Field(ge=0.0, le=60.0), Asked("How often in a minute the beam to a moving SMR breaks.", "N")
    ] = 0.0
    simulation: Annotated[bool, Asked("Controllers in simulation mode, for 'rehearse': no arm moves.")] = False


VERB = Verb("emulate", EmulateRequest, chapter="emulator")
