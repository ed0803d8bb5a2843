"""Fields that the requests of several verbs have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from cellapp.commands.record import Asked

RunFolder = Annotated[Path, Asked("The run's folder.", "DIR", argument=True)]
ProfilePath = Annotated[Path, Asked("The cell, as YAML.", "PROFILE", argument=True)]
TargetsPath = Annotated[Path | tuple[Any, ...], Asked("Target list: .yaml or .csv.", "TARGETS", argument=True)]
"""A list's file; a program that has targets may give them as they are."""
NewRun = Annotated[Path, Asked("Folder of the new run; must not hold one yet.", "DIR", option="--run")]
Prior = Annotated[Path | None, Asked("Folder of an earlier calibrated run of the same arms, as prior.", "EARLIER")]
OutOfDate = Annotated[bool, Asked("Use the latest model even if it no longer fits the run's data.")]
Strict = Annotated[bool, Asked("Exit code 1 if a result, the page or the certificate is out of date.")]
Jobs = Annotated[
    int | None,
    Field(ge=1, le=1024),
    Asked("Processes, each of one thread; all cores if left out; 1: no other.", "N"),
]
Scheduler = Annotated[str | None, Asked("Compute on the workers of a Dask scheduler, as tcp://HOST:8786.", "ADDRESS")]
