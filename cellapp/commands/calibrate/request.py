"""Request of the verb ``calibrate``."""

from __future__ import annotations

from typing import Annotated

from cellapp.commands.record import Asked, Prior, Request, RunFolder, Stored, Verb
from cellapp.ground.network_kind import NetworkKind


class CalibrateRequest(Request):
    """Identify arms and pair, evaluate on held-out stops, write calibration.json."""

    folder: RunFolder
    parameters: Annotated[bool, Asked("Print the parameters too; 'show DIR parameters' prints stored ones.")] = False
    prior: Prior = None
    network: Annotated[
        NetworkKind | None,
        Asked(
            "Residual network: mlp, a committee from at most 1200 readings; batches, from all readings and recordings"
            " (extra learn), where that is better; none. The profile says it if left out."
        ),
    ] = None


VERB = Verb(
    "calibrate",
    CalibrateRequest,
    chapter="tutorial",
    stored=(
        Stored("calibration", "no calibration is", ("calibrate",)),
        Stored("parameters", "no calibration is", ("calibrate",), view="parameters_view"),
    ),
)
