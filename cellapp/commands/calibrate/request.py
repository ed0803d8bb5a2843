"""What ``calibrate`` is asked for."""

from __future__ import annotations

from typing import Annotated

from cellapp.commands.fields import Prior, RunFolder
from cellapp.commands.record import Asked, Request, Stored, Verb


class CalibrateRequest(Request):
    """Identify arms and pair, evaluate on held-out stops, write calibration.json."""

    folder: RunFolder
    parameters: Annotated[bool, Asked("Print the parameters too; 'show DIR parameters' prints stored ones.")] = False
    prior: Prior = None


VERB = Verb(
    "calibrate",
    CalibrateRequest,
    chapter="tutorial",
    stored=(
        Stored("calibration", "no calibration is", ("calibrate",)),
        Stored("parameters", "no calibration is", ("calibrate",), view="parameters_view"),
    ),
)
