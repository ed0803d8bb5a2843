"""``run`` and ``demo``: all verbs one after the other, on a profile or on the simulated cell."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.interfaces.cli.job import Job, require_none
from cellapp.interfaces.cli.motion import asking
from cellapp.interfaces.cli.options import AllowMotion, JsonOption, ProfilePath
from cellapp.interfaces.cli.show import show_discovery


def run(
    profile: ProfilePath,
    folder: Annotated[
        Path | None, typer.Option("--run", metavar="DIR", help="Folder of the new run; else a new one below logs/.")
    ] = None,
    allow_motion: AllowMotion = False,
    json_file: JsonOption = None,
) -> None:
    """Everything, unattended: plan, collect, calibrate, discover, compensate, verify, report."""
    with Job(json_file) as job:
        _run_whole(job, profile, folder, allowed=allow_motion)


def demo(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Profile and run go into FOLDER/profiles and FOLDER/logs.")
    ] = Path(),
    full: Annotated[bool, typer.Option("--full", help="All 400 stops instead of 80.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Try the program without hardware: write the simulated cell's profile, run everything, report."""
    from cellapp.cell.profile.starters import FOLDER, TWIN, TWIN_SMALL, write_starter
    from cellapp.commands.plan.run import default_folder

    with Job(json_file) as job:
        name = TWIN if full else TWIN_SMALL
        profile = folder / FOLDER / f"{name}.yaml"
        if profile.is_file():
            job.say(f"{profile} exists already and is used as it is")
        else:
            write_starter(name, folder)
            job.say(f"written: {profile}")
        _run_whole(job, profile, folder / default_folder(name), allowed=False)


def _run_whole(job: Job, profile: Path, folder: Path | None, *, allowed: bool) -> None:
    from cellapp.cell.profile import load_profile
    from cellapp.commands.calibrate.view import calibration_tables, tracker_sentences
    from cellapp.commands.collect.view import collect_lines, other_notes
    from cellapp.commands.compensate.tables import verification_tables
    from cellapp.commands.run.run import run_whole
    from cellapp.interfaces.page.page import write_page

    ask = asking(job, load_profile(profile).name, allowed=allowed)
    result = run_whole(profile, folder, write_page, job.listen, job.control, ask=ask)
    if result.collect is not None:
        job.say(*collect_lines(result.collect))
    if result.calibrate is not None:
        job.show(calibration_tables(result.calibrate))
    if result.discover is not None:
        show_discovery(job, result.discover)
    if result.verify is not None:
        job.show(verification_tables(result.verify))
    if result.calibrate is not None:
        job.say(*tracker_sentences(result.calibrate))
    job.say(
        *other_notes(result.collect, result.notes),
        f"run: {result.run}   report: {Path(result.run) / 'report.html'}",
    )
    job.result(result)
    require_none([] if result.collect is None else result.collect.complaints(), "collect")
    require_none([] if result.verify is None else result.verify.complaints(), "verification")
