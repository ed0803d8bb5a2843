"""Request of the verb ``init``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import model_validator

from cellapp.commands.record import Asked, Request, Verb

TABLES = (".csv", ".txt", ".tsv", ".dat")
"""Endings of files of readings; others are read, too."""


class InitRequest(Request):
    """Write a new profile as YAML; with --demo also run everything, simulated. Nothing is overwritten."""

    folder: Annotated[Path, Asked("The profile goes into FOLDER/profiles.", "FOLDER", argument=True)] = Path()
    demo: Annotated[bool, Asked("The simulated cell, everything run on it, and its report below FOLDER/logs.")] = False
    full: Annotated[bool, Asked("all 400 stops instead of 80.", of="demo")] = False
    sweeps: Annotated[
        bool, Asked("20 stops, and a sweep of each arm about every one: calibration in motion.", of="demo")
    ] = False
    twin: Annotated[bool, Asked("The simulated cell, to try the program without hardware.")] = False
    starter: Annotated[str | None, Asked("A copy of a profile that comes with cellapp.", "NAME", option="--from")] = (
        None
    )
    answers: Annotated[Path | None, Asked("From answers; see 'cellapp docs cell'.", "FILE")] = None
    readings: Annotated[
        Path | None,
        Asked(
            "For readings recorded elsewhere; see 'cellapp docs readings'.",
            "FILE",
            label="readings",
            suffixes=TABLES,
            hint="CSV or text, with a row of names",
        ),
    ] = None
    arm: Annotated[
        str | None,
        Asked(
            "an arm type by name, its file, or D-H rows (CSV).",
            "TYPE",
            label="arm",
            hint="name of an arm type, its file, or D-H rows; empty: which would fit?",
            of="readings",
        ),
    ] = None
    modified: Annotated[bool, Asked("the rows are modified D-H (Craig).", of="arm")] = False
    angles: Annotated[
        Literal["rad", "deg"] | None,
        Asked("unit of joint positions, if it is not found.", label="joint positions in", of="readings"),
    ] = None
    lengths: Annotated[
        Literal["m", "mm"] | None, Asked("unit of points, if it is not found.", label="points in", of="readings")
    ] = None
    column: Annotated[
        tuple[str, ...], Asked("the column that counts, where two may be meant.", "NAME", of="readings")
    ] = ()
    rows: Annotated[
        Literal["stops", "motion"] | None, Asked("what the rows are, if it is not found.", of="readings")
    ] = None
    name: Annotated[str | None, Asked("name of the profile.", "NAME", of="readings")] = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        """Refuse none or several sources, and two numbers of stops."""
        if self.full and self.sweeps:
            raise ValueError("--sweeps has 20 stops, --full 400: give one of them")
        if self.demo + self.twin + sum(one is not None for one in (self.starter, self.answers, self.readings)) != 1:
            from cellapp.cell.profile.starters import starter_profiles  # late: needed only for a message

            listed = "\n".join(f"  {item.name:14} {item.sentence}" for item in starter_profiles())
            raise ValueError(
                "give one of --demo, --twin, --from NAME, --answers FILE and --readings FILE. Profiles that come with"
                f" cellapp:\n{listed}"
            )
        return self


VERB = Verb("init", InitRequest, chapter="cell", question="Calibrate readings that were recorded elsewhere")
