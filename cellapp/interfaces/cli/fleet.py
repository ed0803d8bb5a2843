"""``fleet``: many runs, what has changed in each arm over time, and where its trends lead; it only reads runs.
``recalibrate``: every run whose calibration or discovery is out of date, computed again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.commands.record import Writes
from cellapp.ground.errors import CheckFailed
from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.options import Jobs, JsonOption, Scheduler, resources_of

Folders = Annotated[
    list[Path], typer.Argument(metavar="DIR...", help="Folders of runs, or of single runs; searched below.")
]


def fleet(
    folders: Folders,
    page: Annotated[
        Path | None,
        typer.Option("--page", metavar="FILE", help="Write one self-contained HTML page to FILE."),
        Writes.FILE,
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit code 1 if any arm is beyond its tolerance or has changed.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Follow every arm over its runs: parameters, effects, errors, trends to the tolerance."""
    from cellapp.commands.fleet.run import fleet as fleet_of
    from cellapp.commands.fleet.view import fleet_sentences, fleet_tables

    with Job(json_file) as job:
        result = fleet_of(folders)
        job.show(fleet_tables(result))
        job.say(*fleet_sentences(result))
        if page is not None:
            from cellapp.interfaces.page.fleet_page import write_fleet_page

            job.say(f"page: {write_fleet_page(result, page, job.outputs)}")
        job.result(result)
        if strict and (complaints := result.complaints()):
            raise CheckFailed(f"fleet: {len(complaints)} of {len(result.arms)} arms: {'; '.join(complaints)}")


def recalibrate(
    folders: Folders,
    again: Annotated[bool, typer.Option("--again", help="Compute again also what still holds.")] = False,
    calibration_only: Annotated[bool, typer.Option("--calibration-only", help="Search no effects.")] = False,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    json_file: JsonOption = None,
) -> None:
    """Calibrate and discover again every run that is out of date; each run keeps its results."""
    from cellapp.commands.recalibrate.run import recalibrate as recalibrate_all
    from cellapp.commands.recalibrate.view import recalibration_sentences, recalibration_table

    with Job(json_file) as job:
        result = recalibrate_all(
            folders,
            force=again,
            search=not calibration_only,
            resources=resources_of(jobs, scheduler),
            listener=job.listen,
            cancel=job.control,
        )
        if result.made:
            job.show([recalibration_table(result)])
        job.say(*recalibration_sentences(result))
        job.result(result)
        if result.failed:
            raise CheckFailed(
                f"recalibrate: {len(result.failed)} of {len(result.failed) + len(result.runs)} runs failed"
            )
