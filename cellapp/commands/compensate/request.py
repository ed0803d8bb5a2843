"""Request of the verb ``compensate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.record import Asked, Request, RunFolder, Stored, TargetsPath, Verb
from cellapp.ground.outputs import Writes


class CompensateRequest(Request):
    """Joint positions that bring the real arms to Cartesian targets or along paths, from the calibrated model.

    TARGETS may be a path file (YAML), lines and arcs with speeds: 'cellapp docs targets' explains it. Nothing moves.
    """

    folder: RunFolder
    targets: TargetsPath
    out: Annotated[
        Path | None,
        Asked(
            "Of paths: where to write joint positions over time, .csv, or URScript, .script, a file for each arm.",
            "FILE",
            writes=Writes.FILES,
        ),
    ] = None


VERB = Verb(
    "compensate",
    CompensateRequest,
    chapter="targets",
    stored=(
        Stored("targets", "no compensated targets are", ("compensate",)),
        Stored("paths", "no paths are", ("path",), view="paths_view"),
    ),
)
