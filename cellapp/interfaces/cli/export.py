"""``export``: readings as CSV, calibrated arms in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.commands.record import Writes
from cellapp.ground.errors import InputError
from cellapp.interfaces.cli.job import Job, open_run
from cellapp.interfaces.cli.options import JsonOption, RunFolder

_FORMATS = "ur-calibration, ur-description, urdf, dh, dh-plain, poe, parameters, urdf-cell, commands or urscript."
"""For the help, which must not load the formats; a test compares them."""


def export(
    folder: RunFolder,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Where to write the readings."), Writes.FILE
    ] = None,
    plan: Annotated[
        Path | None, typer.Option("--plan", metavar="FILE", help="Where to write the plan."), Writes.FILE
    ] = None,
    form: Annotated[
        str | None, typer.Option("--as", metavar="FORMAT", help="Write calibrated arms or commands as " + _FORMATS)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="With --as: the file; several arms get one each, FILE-ARM."),
        Writes.FILES,
    ] = None,
    arm: Annotated[str | None, typer.Option("--arm", metavar="NAME", help="With --as: this arm only.")] = None,
    stage: Annotated[
        str | None,
        typer.Option(
            "--stage", metavar="STAGE", help="With --as: calibrate or discover; of commands compensate or verify."
        ),
    ] = None,
    geometry: Annotated[
        Path | None,
        typer.Option("--geometry", metavar="FILE", help="The arms as one JSON file, for programs that read it."),
        Writes.FILE,
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Write the readings or the plan of a run as CSV, or calibrated arms and commands for other programs.

    Importing the CSV again gives the same readings bit for bit, and so does planning from the plan.
    'cellapp docs exports' describes the formats.
    """
    from cellapp.cell.exports.words import export_lines
    from cellapp.commands.export.run import export_as_run, export_run

    with Job(json_file) as job, open_run(folder) as opened:
        if form is None and out is None and arm is None and stage is None:
            result = export_run(opened, csv, geometry, plan, job.outputs)
        elif form is None or out is None or any((csv, geometry, plan)):
            raise InputError("export: --as FORMAT and --out FILE belong together, without --csv, --plan and --geometry")
        else:
            result = export_as_run(opened, form, out, arm, stage, job.outputs)
        job.say(*export_lines(result))
        job.result(result)
