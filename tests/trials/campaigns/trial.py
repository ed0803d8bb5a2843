"""Many campaigns: ``cellapp trials campaigns``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, ignore
from cellapp.ground.results import Record, Result
from cellapp.ground.scale.executor import IN_PROCESS, Resources
from cellapp.ground.scale.gather import gather
from cellapp.ground.scale.task import Batch, Seed, TaskKind
from tests.trials.campaigns.campaign import Bench, Campaign, make_bench, run_campaign
from tests.trials.campaigns.faults import KINDS
from tests.trials.campaigns.monitor import KINDS_OF_FAILURE

STOPS = 400


class FailedCampaign(Record):
    """What must not be in one campaign, and was; the campaign of its seed shows it again."""

    seed: int
    failures: tuple[str, ...]


class CampaignsResult(Result, schema="cellapp-trials-campaigns"):
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
    not_run : tuple of str
        Campaigns that could not be run to their end, and why.
    """

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
    not_run: tuple[str, ...] = ()


class CampaignPlan(Record):
    """What all campaigns share: the cell, and the number of its stops."""

    profile: Profile
    stops: int


class OneCampaign(Record):
    """What became of one campaign."""

    campaign: Campaign


def campaign_trials(
    profile: Profile,
    n: int,
    seed: int,
    stops: int = STOPS,
    resources: Resources = IN_PROCESS,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> CampaignsResult:
    """Run ``n`` campaigns of ``stops`` stops; the result depends on their seeds only.

    Raises
    ------
    InputError
        If the profile has no simulated cell.
    CellappError
        If already the campaign without faults fails.
    Cancelled
    """
    seeds = range(seed, seed + n)
    plan = CampaignPlan(profile=profile, stops=stops)
    batch = Batch(CAMPAIGNS, plan, [Seed(seed=one) for one in seeds], [f"seed {one}" for one in seeds])
    gathered = gather(batch, "campaigns", resources, listener, cancel)
    result = _summary([one.campaign for one in gathered.found], seed, stops)
    return result.model_copy(update={"not_run": gathered.failed})


def _bench(plan: CampaignPlan) -> Bench:
    return make_bench(plan.profile, plan.stops)


def _campaign(bench: Bench, drawn: Seed) -> OneCampaign:
    return OneCampaign(campaign=run_campaign(bench, drawn.seed)[0])


CAMPAIGNS = TaskKind("tests.trials.campaigns.trial:CAMPAIGNS", CampaignPlan, Seed, OneCampaign, _bench, _campaign)


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
