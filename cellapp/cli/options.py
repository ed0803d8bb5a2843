"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ProfilePath = Annotated[Path, typer.Argument(metavar="PROFILE", help="The cell, as YAML.")]
RunFolder = Annotated[Path, typer.Argument(metavar="DIR", help="The run's folder.")]
NewRun = Annotated[Path, typer.Option("--run", metavar="DIR", help="Folder of the new run; must not hold one yet.")]
TargetsPath = Annotated[Path, typer.Argument(metavar="TARGETS", help="Target list: .yaml or .csv.")]
PriorOption = Annotated[
    Path | None,
    typer.Option("--prior", metavar="EARLIER", help="Folder of an earlier calibrated run of the same arms, as prior."),
]
JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON to FILE; '-' is standard output.")
]
AllowMotion = Annotated[
    bool,
    typer.Option("--allow-motion", help="Let real arms move without asking: the cell is clear, a person watches it."),
]
