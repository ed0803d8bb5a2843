"""Request of the verb ``export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import model_validator

from cellapp.commands.record import Asked, Request, RunFolder, Verb
from cellapp.ground.outputs import Writes

_FORMATS = "ur-calibration, ur-description, urdf, dh, dh-plain, poe, parameters, urdf-cell, commands or urscript."
"""Formats for the help, which must not load them; a test compares both lists."""
STAGES = ("calibrate", "discover", "compensate", "verify")


class ExportRequest(Request):
    """Write readings, recordings or the plan of a run as CSV, or calibrated arms and commands for other programs.

    Importing the CSV again gives the same readings bit for bit, and so does planning from the plan.
    'cellapp docs exports' describes the formats.
    """

    folder: RunFolder
    csv: Annotated[Path | None, Asked("Where to write the readings.", "FILE", writes=Writes.FILE)] = None
    joints: Annotated[Path | None, Asked("Where to write the joints of recordings.", "FILE", writes=Writes.FILE)] = None
    points: Annotated[Path | None, Asked("Where to write the points of recordings.", "FILE", writes=Writes.FILE)] = None
    plan: Annotated[Path | None, Asked("Where to write the plan.", "FILE", label="plan", writes=Writes.FILE)] = None
    form: Annotated[
        str | None,
        Asked(
            f"Write calibrated arms or commands as {_FORMATS}", "FORMAT", option="--as", label="format", hint=_FORMATS
        ),
    ] = None
    out: Annotated[
        Path | None,
        Asked("With --as: the file; several arms get one each, FILE-ARM.", "FILE", label="file", writes=Writes.FILES),
    ] = None
    arm: Annotated[str | None, Asked("With --as: this arm only.", "NAME", label="arm (empty: all)")] = None
    stage: Annotated[
        str | None,
        Asked(
            f"With --as: {STAGES[0]} or {STAGES[1]}; of commands {STAGES[2]} or {STAGES[3]}.",
            "STAGE",
            label="of stage",
            hint="empty: in force, or last",
        ),
    ] = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        """Refuse a format without a file, and a format beside readings or plan."""
        of_format = (self.form, self.out, self.arm, self.stage)
        plain = any((self.csv, self.plan, self.joints, self.points))
        if any(one is not None for one in of_format) and (self.form is None or self.out is None or plain):
            raise ValueError("--as FORMAT and --out FILE belong together, without the options of single files")
        return self


VERB = Verb("export", ExportRequest, chapter="exports", question="Write for other programs")
