"""``follow``: joint paths along which the real arm follows lines and arcs, planned, driven and measured."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.commands.record import Writes
from cellapp.interfaces.cli.job import Job, open_run, require_none
from cellapp.interfaces.cli.motion import asking
from cellapp.interfaces.cli.options import AllowMotion, JsonOption, OutOfDate, RunFolder


def follow(
    folder: RunFolder,
    path: Annotated[Path, typer.Argument(metavar="PATH", help="Path file, YAML; 'cellapp docs paths' explains it.")],
    arm: Annotated[str | None, typer.Option("--arm", metavar="NAME", help="Only the paths of this arm.")] = None,
    drive: Annotated[bool, typer.Option("--drive", help="Let the arms follow the paths.")] = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="Let the arms follow the paths, and measure how far the SMR is from them.")
    ] = False,
    rehearse: Annotated[
        bool, typer.Option("--rehearse", help="Drive each path once before, and correct it by how the joints lag.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="CSV", help="Write the joint positions over time as CSV."),
        Writes.FILE,
    ] = None,
    out_of_date: OutOfDate = False,
    allow_motion: AllowMotion = False,
    json_file: JsonOption = None,
) -> None:
    """Turn poses with speeds into joint paths of the calibrated model. Nothing moves without --drive or --verify."""
    from cellapp.cell.targets.path_file import load_paths
    from cellapp.commands.follow.run import follow_run
    from cellapp.commands.follow.view import path_sentences, path_tables

    with Job(json_file) as job, open_run(folder, write=True) as opened:
        specs = load_paths(path, opened.profile, arm)
        ask = asking(job, opened.profile.name, allowed=allow_motion) if drive or verify else None
        result = follow_run(
            opened,
            specs,
            job.listen,
            job.control,
            driving="verify" if verify else "drive" if drive else "plan",
            rehearse=rehearse,
            out_of_date=out_of_date,
            csv=out,
            outputs=job.outputs,
            ask=ask,
        )
        job.show(path_tables(result))
        job.say(*path_sentences(result))
        job.result(result)
        require_none(result.complaints(), "follow")
