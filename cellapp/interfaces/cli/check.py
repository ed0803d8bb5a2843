"""``check``: whether a stored calibration still holds, from about twenty stops."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.interfaces.cli.job import Job, open_run, require_none
from cellapp.interfaces.cli.motion import asking
from cellapp.interfaces.cli.options import AllowMotion, JsonOption, RunFolder


def check(
    folder: RunFolder,
    stops: Annotated[
        int, typer.Option("--stops", metavar="N", min=4, max=1000, help="Stops at most; fewer where that is enough.")
    ] = 20,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit code 1 also if the model was out of date before the check.")
    ] = False,
    simulated_plant: Annotated[
        Path | None,
        typer.Option(
            "--simulated-plant",
            metavar="PROFILE",
            help="Simulated cells only: the hidden physics of this profile, for this check alone.",
        ),
    ] = None,
    allow_motion: AllowMotion = False,
    json_file: JsonOption = None,
) -> None:
    """Measure a few stops: does the calibration still hold, what has moved or changed, how much accuracy is left."""
    from cellapp.commands.check.run import check_run, plant_of
    from cellapp.commands.check.view import check_sentences, check_tables

    with Job(json_file) as job, open_run(folder, write=True) as opened:
        result = check_run(
            opened,
            job.listen,
            job.control,
            stops=stops,
            simulated_plant=None if simulated_plant is None else plant_of(simulated_plant),
            ask=asking(job, opened.profile.name, allowed=allow_motion),
        )
        job.show(check_tables(result))
        job.say(*check_sentences(result))
        job.result(result)
        require_none(result.complaints(strict=strict), "check")
