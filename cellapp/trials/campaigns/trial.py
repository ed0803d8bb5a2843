"""Many campaigns: ``cellapp trials campaigns``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.results import Record, Result
from cellapp.trials.campaigns.campaign import Bench, Campaign, make_bench, run_campaign
from cellapp.trials.campaigns.faults import KINDS
from cellapp.trials.campaigns.monitor import KINDS_OF_FAILURE
from cellapp.trials.processes import in_processes

STOPS = 400
_AT_ONCE = 10
"""Campaigns of one task: some seconds, so that a cancelled job ends soon."""


class FailedCampaign(Record):
    """What must not be in one campaign, and was; the campaign of its seed shows it again."""

    seed: int
    failures: tuple[str, ...]


class CampaignsResult(Result):
    """``trials campaigns``: what became of ``n`` campaigns of the seeds from ``seed`` on.

    Attributes
    ----------
    failures : mapping
        Kind of failure -> how often.
    failed : tuple of FailedCampaign
    faults : mapping
        Fault -> how often it struck.
    sessions : mapping
        How sessions of the program ended -> how often.
    holds, suspensions : int
        How often the engine held for a person, and waited for a cause to pass.
    readings, missing : int
        Stored readings, and planned ones that are missing with a reason.
    seconds_mean, seconds_worst : float
        Processor time of one campaign, in one thread [s].
    simulated_h : float
        Simulated time of all campaigns [h].
    """

    schema_: Literal["cellapp-trials-campaigns"] = "cellapp-trials-campaigns"
    version: Literal[1] = 1
    n: int
    seed: int
    stops: int
    failures: Mapping[str, int]
    failed: tuple[FailedCampaign, ...]
    faults: Mapping[str, int]
    sessions: Mapping[str, int]
    holds: int
    suspensions: int
    readings: int
    missing: int
    seconds_mean: float
    seconds_worst: float
    simulated_h: float


def campaign_trials(
    profile: Profile,
    n: int,
    seed: int,
    stops: int = STOPS,
    jobs: int = 1,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> CampaignsResult:
    """Run ``n`` campaigns of ``stops`` stops in ``jobs`` processes; the result depends on their seeds only.

    Raises
    ------
    InputError
        If the profile has no simulated cell.
    CellappError
        If already the campaign without faults fails.
    Cancelled
    """
    cancel = cancel or CancelToken()
    listener(Progress("campaigns", 0, n, "planning"))
    with threadpool_limits(1):
        bench = make_bench(profile, stops, cancel)
        seeds = range(seed, seed + n)
        campaigns = []
        at_once = 1 if jobs == 1 else _AT_ONCE
        tasks = (seeds[k : k + at_once] for k in range(0, n, at_once))
        for campaign in chain.from_iterable(in_processes(partial(run_campaigns, bench), tasks, jobs, cancel)):
            campaigns.append(campaign)
            note = f"{sum(bool(one.failures) for one in campaigns)} failed"
            listener(Progress("campaigns", len(campaigns), n, note))
    return _summary(sorted(campaigns, key=lambda campaign: campaign.seed), seed, stops)


def run_campaigns(bench: Bench, seeds: Sequence[int]) -> list[Campaign]:
    """Run the campaigns of some seeds."""
    return [run_campaign(bench, seed)[0] for seed in seeds]


def _summary(campaigns: Sequence[Campaign], seed: int, stops: int) -> CampaignsResult:
    failed = [one for one in campaigns if one.failures]
    kinds = Counter(failure.kind for one in failed for failure in one.failures)
    faults, sessions = Counter[str](), Counter[str]()
    for one in campaigns:
        faults.update(one.struck)
        sessions.update(one.ended)
    return CampaignsResult(
        n=len(campaigns),
        seed=seed,
        stops=stops,
        failures={kind: kinds[kind] for kind in KINDS_OF_FAILURE},
        failed=tuple(FailedCampaign(seed=one.seed, failures=tuple(map(str, one.failures))) for one in failed),
        faults={kind: faults[kind] for kind in KINDS},
        sessions=dict(sorted(sessions.items())),
        holds=sum(one.holds for one in campaigns),
        suspensions=sum(one.suspensions for one in campaigns),
        readings=sum(one.readings for one in campaigns),
        missing=sum(one.missing for one in campaigns),
        seconds_mean=float(np.mean([one.seconds for one in campaigns])),
        seconds_worst=max(one.seconds for one in campaigns),
        simulated_h=sum(one.simulated_s for one in campaigns) / 3600.0,
    )
