"""``at-rest``: a person has seen an arm at rest that counted as moving."""

from __future__ import annotations

from typing import Annotated

import typer

from cellapp.interfaces.cli.job import Job, open_run
from cellapp.interfaces.cli.options import JsonOption, RunFolder


def at_rest(
    folder: RunFolder,
    arm: Annotated[str, typer.Argument(metavar="ARM", help="The arm, as the profile names it.")],
    json_file: JsonOption = None,
) -> None:
    """Say that you have seen an arm at rest that a run counts as moving since its stop was not confirmed."""
    from cellapp.cell.run.unseen_arms import BY_PERSON, note_at_rest
    from cellapp.commands.at_rest.result import AtRestResult

    with Job(json_file) as job, open_run(folder, write=True) as run:
        counted = note_at_rest(run, arm, BY_PERSON)
        job.say(f"arm {arm}: {'recorded as seen at rest' if counted else 'it did not count as moving'}")
        job.result(AtRestResult(run=str(folder), arm=arm, counted_as_moving=counted))
