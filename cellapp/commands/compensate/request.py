"""Request of the verb ``compensate``."""

from __future__ import annotations

from cellapp.commands.fields import RunFolder, TargetsPath
from cellapp.commands.record import Request, Stored, Verb


class CompensateRequest(Request):
    """Joint positions that bring the real arms to Cartesian targets, from the calibrated model."""

    folder: RunFolder
    targets: TargetsPath


VERB = Verb(
    "compensate",
    CompensateRequest,
    chapter="targets",
    stored=(Stored("targets", "no compensated targets are", ("compensate",)),),
)
