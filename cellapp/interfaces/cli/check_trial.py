"""``cellapp trials check``: trials of the ten-minute check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.interfaces.cli.job import Job, require_none
from cellapp.interfaces.cli.options import (
    DEFAULT_CELL,
    DrawnCells,
    FirstSeed,
    Jobs,
    JsonOption,
    MarkdownFile,
    Mix,
    Scheduler,
    SeriesFolder,
    SeriesProfiles,
    SimulatedCell,
    Store,
    resources_of,
)
from cellapp.interfaces.cli.trial_files import state_result


def check(
    profile: SimulatedCell = DEFAULT_CELL,
    seeds: DrawnCells = 10,
    first: FirstSeed = 0,
    earlier: Annotated[int, typer.Option("--earlier", min=40, help="Stops of the calibration.")] = 400,
    stops: Annotated[int, typer.Option("--stops", min=6, help="Stops of a check at most.")] = 20,
    unchanged: Annotated[int, typer.Option("--unchanged", min=0, help="Checks of each cell as it was.")] = 50,
    mix: Mix = False,
    anew: Annotated[bool, typer.Option("--anew", help="The tracker was set up anew before each check.")] = False,
    real: Annotated[
        str, typer.Option("--real", metavar="LIST", help="Check series of real robots instead, as C,D,UR5.")
    ] = "",
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    store: Store = None,
    data: SeriesFolder = Path("tests/fixtures"),
    profiles: SeriesProfiles = Path("profiles"),
    markdown: MarkdownFile = None,
    json_file: JsonOption = None,
) -> None:
    """How often the ten-minute check finds and names a change, and how often it finds one where there is none."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.check_real import real_check_trials
    from cellapp.commands.trials.check_tables import check_trial_sentences, check_trial_tables
    from cellapp.commands.trials.check_trial import CheckPlan, check_trials

    with Job(json_file) as job:
        chosen, resources = range(first, first + seeds), resources_of(jobs, scheduler, store)
        if real:
            result = real_check_trials(
                [name.strip() for name in real.split(",")], chosen, rows=earlier, planned=stops, checks=unchanged,
                data=data, profiles=profiles, resources=resources, listener=job.listen, cancel=job.control,
            )  # fmt: skip
        else:
            plan = CheckPlan(
                profile=load_profile(profile),
                earlier=earlier,
                planned=stops,
                unchanged=unchanged,
                mix=mix,
                station_free=anew,
            )
            result = check_trials(plan, chosen, resources, job.listen, job.control)
        state_result(job, result, check_trial_tables(result), check_trial_sentences(result), markdown)
        require_none(result.complaints(), "trials check")
