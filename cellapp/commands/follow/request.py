"""Request of the verb ``follow``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import model_validator

from cellapp.commands.fields import OutOfDate, RunFolder
from cellapp.commands.record import Asked, Request, Stored, Verb
from cellapp.ground.outputs import Writes


class FollowRequest(Request):
    """Turn poses with speeds into joint paths of the calibrated model. Nothing moves without --drive or --verify."""

    folder: RunFolder
    path: Annotated[
        Path,
        Asked(
            "Path file, YAML; 'cellapp docs paths' explains it.",
            "PATH",
            argument=True,
            label="path file",
            suffixes=(".yaml", ".yml"),
        ),
    ]
    arm: Annotated[
        str | None, Asked("Only the paths of this arm.", "NAME", label="only arm", hint="empty: all of them")
    ] = None
    drive: Annotated[bool, Asked("Let the arms follow the paths.", label="drive: the arms follow the paths")] = False
    verify: Annotated[
        bool,
        Asked(
            "Let the arms follow the paths, and measure how far the SMR is from them.",
            label="drive and measure: how far the SMR is from the path",
        ),
    ] = False
    rehearse: Annotated[
        bool,
        Asked(
            "Drive each path once before, and correct it by how the joints lag.",
            label="rehearse: drive once before, correct by how the joints lag",
        ),
    ] = False
    out: Annotated[
        Path | None,
        Asked(
            "Write the joint positions over time as CSV.",
            "CSV",
            label="joint positions",
            hint="CSV file to write; may be empty",
            suffixes=(".csv",),
            writes=Writes.FILE,
        ),
    ] = None
    out_of_date: OutOfDate = False

    def moves(self) -> bool:
        """Return whether they are driven."""
        return self.drive or self.verify

    @model_validator(mode="after")
    def _rehearsal_moves(self) -> FollowRequest:
        if self.rehearse and not self.moves():
            raise ValueError("a rehearsal moves the arms; ask for driving or verifying too (--drive, --verify)")
        return self


VERB = Verb(
    "follow",
    FollowRequest,
    chapter="paths",
    moves_arms=True,
    question="Follow paths",
    stored=(Stored("paths", "no paths are", ("follow", "path")),),
)
