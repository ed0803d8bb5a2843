"""Request of the verb ``import``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import model_validator

from cellapp.commands.fields import NewRun, ProfilePath
from cellapp.commands.record import Asked, Request, Verb


class ImportRequest(Request):
    """Make a run from readings, or from recordings of motion, that were measured elsewhere.

    A recording is a file of joint positions and one of points, each with the clock of its device; several are given by
    repeating both options, in the same order.
    """

    profile: ProfilePath
    csv: Annotated[Path | None, Asked("Readings; 'cellapp docs files' has the columns.", "CSV", argument=True)] = None
    folder: NewRun
    in_order: Annotated[
        bool,
        Asked("Rows stand in the order of measurement (with time_s: by time); derive missing approach and step."),
    ] = False
    reference_nests: Annotated[
        Path | None, Asked("Nests on the floor that tie tracker stations: station, nest, x_m, y_m, z_m.", "FILE")
    ] = None
    smr: Annotated[
        str | None,
        Asked("Take only this SMR, where several were measured at a stop; three or more give a rotation.", "NAME"),
    ] = None
    joints: Annotated[tuple[Path, ...], Asked("Joint positions of a motion: time_s, q1, q2, ...", "FILE")] = ()
    points: Annotated[tuple[Path, ...], Asked("Points of the same motion: time_s, x_m, y_m, z_m.", "FILE")] = ()
    arm: Annotated[str | None, Asked("The arm of recordings that do not say it.", "NAME")] = None

    @model_validator(mode="after")
    def _something(self) -> Self:
        """Return readings, recordings or both."""
        if len(self.joints) != len(self.points):
            raise ValueError("give a file of --joints and one of --points for each recording")
        if self.csv is None and not self.joints:
            raise ValueError("give the CSV of readings, or --joints and --points of a recording")
        if self.arm is not None and not self.joints:
            raise ValueError("--arm belongs to --joints and --points; a CSV of readings has a column 'arm'")
        if self.in_order and self.csv is None:
            raise ValueError("--in-order belongs to a CSV of readings")
        if self.smr is not None and self.csv is None:
            raise ValueError("--smr belongs to a CSV of readings with a column 'smr'")
        if self.reference_nests is not None and self.csv is None:
            raise ValueError("--reference-nests belongs to a CSV of readings with a column 'station'")
        return self


VERB = Verb("import", ImportRequest, chapter="readings")
