"""``python -m tests.trials.campaigns``: many campaigns with faults, on simulated time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.cell.profile import load_profile
from cellapp.commands.trials.skeleton import not_computed
from cellapp.commands.view.table import Column, Table, number_column
from cellapp.ground.errors import CheckFailed
from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.options import Jobs, JsonOption, Scheduler, Store, resources_of
from tests.trials.campaigns.trial import CampaignsResult, campaign_trials
from tests.trials.command import run_trial, trial_command


def campaigns(
    profile: Annotated[Path, typer.Argument(metavar="[PROFILE]", help="A simulated cell, as YAML.")] = Path(
        "profiles/twin.yaml"
    ),
    n: Annotated[int, typer.Option("--n", min=1, help="Campaigns.")] = 50,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the first; the next has the next one.")] = 0,
    stops: Annotated[int, typer.Option("--stops", min=30, help="Stops of each campaign.")] = 400,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    store: Store = None,
    json_file: JsonOption = None,
) -> None:
    """The whole engine on simulated devices, disk and person, with seeded faults of all kinds on simulated time."""
    with Job(json_file) as job:
        result = campaign_trials(
            load_profile(profile), n, seed, stops, resources_of(jobs, scheduler, store), job.listen, job.control
        )
        job.show(campaign_tables(result))
        job.say(
            f"{result.n - len(result.failed)} of {result.n} campaigns as they should be; {result.missing} planned"
            f" readings are missing with a reason; a campaign took {result.seconds_mean:.2f} s, at most"
            f" {result.seconds_worst:.2f} s, for {3600 * result.simulated_h / result.n:.0f} s of simulated time"
        )
        for failed in result.failed:
            job.say(f"seed {failed.seed}: {'; '.join(failed.failures[:3])}")
            job.say(f"  again: python -m tests.trials.campaigns {profile} --n 1 --seed {failed.seed} --stops {stops}")
        job.result(result)
        if result.not_run:
            raise CheckFailed(not_computed(result.not_run))
        if result.failed:
            raise CheckFailed(f"trials campaigns: {len(result.failed)} of {result.n} campaigns failed; see above")


def campaign_tables(result: CampaignsResult) -> list[Table]:
    """What must not be and how often it was, what struck, how sessions ended."""
    title = f"{result.n} campaigns of {result.stops} stops, {result.readings} readings"
    judged = Table(title, (Column("must not be"), number_column("found", "d")), tuple(result.failures.items()))
    struck = Table("Faults", (Column("fault"), number_column("struck", "d")), tuple(result.faults.items()))
    ends = (*result.sessions.items(), ("holds for a person", result.holds), ("suspended", result.suspensions))
    return [struck, Table("Sessions", (Column("end"), number_column("n", "d")), ends), judged]


app = trial_command(campaigns)

if __name__ == "__main__":
    run_trial(app, "campaigns")
