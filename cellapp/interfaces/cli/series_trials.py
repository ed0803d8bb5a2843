"""``cellapp trials league`` and ``cellapp trials signature``: trials on measured series."""

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


def league(
    series: Annotated[str, typer.Option("--series", metavar="LIST", help="Series, separated by commas.")] = "C,D,UR5",
    rows: Annotated[
        str, typer.Option("--rows", metavar="LIST", help="Numbers of rows to learn from, separated by commas.")
    ] = "100,300,all",
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Draws of each.")] = 8,
    network: Annotated[bool, typer.Option("--network", help="Train the residual networks too; slow.")] = False,
    curve: Annotated[bool, typer.Option("--curve", help="Also a learning curve of series C.")] = False,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    store: Store = None,
    data: SeriesFolder = Path("tests/fixtures"),
    profiles: SeriesProfiles = Path("profiles"),
    markdown: MarkdownFile = None,
    json_file: JsonOption = None,
) -> None:
    """Real robots, measured by others: geometry, network and discovery on rows that were held out, against bars."""
    from cellapp.commands.trials.league.series import parse_rows
    from cellapp.commands.trials.league.tables import league_sentences, league_tables
    from cellapp.commands.trials.league.trial import league_trials

    with Job(json_file) as job:
        result = league_trials(
            [name.strip() for name in series.split(",")],
            parse_rows(rows),
            seeds,
            data=data,
            profiles=profiles,
            network=network,
            curve=curve,
            resources=resources_of(jobs, scheduler, store),
            listener=job.listen,
            cancel=job.control,
        )
        state_result(job, result, league_tables(result), league_sentences(result), markdown)
        require_none(result.complaints(), "trials league")


def signature(
    profile: SimulatedCell = DEFAULT_CELL,
    seeds: DrawnCells = 10,
    first: FirstSeed = 0,
    earlier: Annotated[int, typer.Option("--earlier", min=40, help="Stops of the earlier calibration.")] = 400,
    few: Annotated[int, typer.Option("--few", min=5, help="Stops with the earlier calibration.")] = 30,
    many: Annotated[int, typer.Option("--many", min=10, help="Stops without it, to compare with.")] = 150,
    held_out: Annotated[int, typer.Option("--held-out", min=10, help="Stops to compare on.")] = 120,
    mix: Mix = False,
    real: Annotated[bool, typer.Option("--real", help="Series D of a real UR10 with series C as prior.")] = False,
    rows: Annotated[
        str, typer.Option("--rows", metavar="LIST", help="With --real: numbers of rows, separated by commas.")
    ] = "30,60,100",
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    store: Store = None,
    data: SeriesFolder = Path("tests/fixtures"),
    profiles: SeriesProfiles = Path("profiles"),
    markdown: MarkdownFile = None,
    json_file: JsonOption = None,
) -> None:
    """What an arm's earlier calibration is worth when it is calibrated again from few stops, mounted elsewhere."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.league.series import parse_rows
    from cellapp.commands.trials.signature import TwinPlan, real_trials, twin_trials
    from cellapp.commands.trials.signature_tables import signature_sentences, signature_tables

    with Job(json_file) as job:
        chosen, resources = range(first, first + seeds), resources_of(jobs, scheduler, store)
        if real:
            result = real_trials(
                parse_rows(rows),
                chosen,
                data=data,
                profiles=profiles,
                resources=resources,
                listener=job.listen,
                cancel=job.control,
            )
        else:
            plan = TwinPlan(
                profile=load_profile(profile), earlier=earlier, few=few, many=many, held_out=held_out, mix=mix
            )
            result = twin_trials(plan, chosen, resources, job.listen, job.control)
        state_result(job, result, signature_tables(result), signature_sentences(result), markdown)
        require_none(result.complaints(), "trials signature")
