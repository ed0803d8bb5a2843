"""Request of the verb ``calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.record import Asked, Request, RunFolder, Stored, Verb
from cellapp.ground.network_kind import NetworkKind


class CalibrateRequest(Request):
    """Identify arms and pair, evaluate on held-out stops, write calibration.json."""

    folder: RunFolder
    parameters: Annotated[bool, Asked("Print the parameters too; 'show DIR parameters' prints stored ones.")] = False
    prior: Annotated[
        Path | None,
        Asked(
            "Folder of an earlier calibrated run of the same arms, as prior.",
            "EARLIER",
            label="prior",
            hint="folder of a run; empty: none",
        ),
    ] = None
    network: Annotated[
        NetworkKind | None,
        Asked(
            "Residual network: mlp, a committee from at most 1200 readings; batches, from all readings and recordings"
            " (extra learn), where that is better; none. The profile says it if left out.",
            label="network",
            hint="mlp, batches or none; empty: that of the profile",
        ),
    ] = None


VERB = Verb(
    "calibrate",
    CalibrateRequest,
    chapter="tutorial",
    question="Calibrate",
    stored=(
        Stored("calibration", "no calibration is", ("calibrate",)),
        Stored("parameters", "no calibration is", ("calibrate",), view="parameters_view"),
    ),
)
