"""``correct``: a copy of a controller's program whose targets the real arm reaches."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.commands.record import Writes
from cellapp.ground.errors import InputError
from cellapp.interfaces.cli.job import Job, open_run
from cellapp.interfaces.cli.options import JsonOption, RunFolder


def correct(
    folder: RunFolder,
    program: Annotated[Path, typer.Argument(metavar="PROGRAM", help="Program of a UR controller: .script or .urp.")],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="The corrected copy, of the same kind."), Writes.FILES
    ],
    arm: Annotated[
        str | None, typer.Option("--arm", metavar="NAME", help="Whose program it is; needed with several arms.")
    ] = None,
    tcp: Annotated[
        str | None,
        typer.Option(
            "--tcp", metavar="X,Y,Z,RX,RY,RZ", help="TCP in the flange frame [m, rad], if the program sets none."
        ),
    ] = None,
    partly: Annotated[
        bool, typer.Option("--partly", help="Write although some targets cannot be corrected; they stay as they are.")
    ] = False,
    extrapolate: Annotated[
        bool, typer.Option("--extrapolate", help="Correct targets outside the joint ranges of the readings too.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Correct the targets of a UR program by the calibrated model, so that a plain controller truly reaches them.

    Every other line stays byte for byte. Nothing is written while a target cannot be corrected, unless with --partly.
    """
    from cellapp.cell.programs.words import correct_lines, refusal
    from cellapp.commands.correct.run import correct_run, typed_tcp
    from cellapp.commands.correct.view import correct_table

    with Job(json_file) as job, open_run(folder) as opened:
        pose = None if tcp is None else typed_tcp(tcp)
        result = correct_run(
            opened, program, out, arm, tcp=pose, partly=partly, extrapolate=extrapolate, outputs=job.outputs
        )
        job.show([correct_table(result)])
        job.say(*correct_lines(result))
        job.result(result)
        if reason := refusal(result):
            raise InputError(reason)
