"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.ground.outputs import Writes

ProfilePath = Annotated[Path, typer.Argument(metavar="PROFILE", help="The cell, as YAML.")]
RunFolder = Annotated[Path, typer.Argument(metavar="DIR", help="The run's folder.")]
JsonOption = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the result as JSON to FILE; '-' is standard output."),
    Writes.FILE,
]
AllowMotion = Annotated[
    bool,
    typer.Option("--allow-motion", help="Let real arms move without asking: the cell is clear, a person watches it."),
]
Jobs = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        metavar="N",
        min=1,
        max=1024,
        help="Processes, each of one thread; all cores if left out; 1: no other.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="ADDRESS", help="Compute on the workers of a Dask scheduler, as tcp://HOST:8786."
    ),
]
