"""``init``: write a profile to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.cli.job import Job
from cellapp.cli.options import JsonOption
from cellapp.errors import InputError


def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The profile goes into FOLDER/profiles.")] = Path(),
    twin: Annotated[
        bool, typer.Option("--twin", help="The simulated cell, to try the program without hardware.")
    ] = False,
    starter: Annotated[
        str | None, typer.Option("--from", metavar="NAME", help="A copy of a profile that comes with cellapp.")
    ] = None,
    answers: Annotated[
        Path | None,
        typer.Option("--answers", metavar="FILE", help="From answers; see 'cellapp docs cell'."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Write a new profile as commented YAML; nothing is overwritten."""
    from cellapp.commissioning.answers import Written, write_answers
    from cellapp.profile.starters import TWIN, starter_profiles, write_starter
    from cellapp.results import InitResult

    with Job(json_file) as job:
        if twin + (starter is not None) + (answers is not None) != 1:
            listed = "\n".join(f"  {item.name:14} {item.sentence}" for item in starter_profiles() if item.has_device)
            raise InputError(
                "init: give one of --twin, --from NAME and --answers FILE. Profiles that come with cellapp:\n" + listed
            )
        if answers is not None:
            written = write_answers(answers, folder)
        else:
            written = Written(write_starter(TWIN if starter is None else starter, folder), ())
        job.say(*written.notes, f"written: {written.path}", f"next: cellapp doctor {written.path}")
        job.result(InitResult(profile=str(written.path), notes=written.notes))
