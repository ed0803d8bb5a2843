"""One campaign: sessions of the real engine in a world of faults until the run is complete, then the judgement."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.collection.collect import collect_run
from cellapp.control import Aborted, JobControl, Stopped
from cellapp.errors import CellappError, InputError
from cellapp.profile import Profile
from cellapp.profile.collection import AirLimits, Collection, Reference, Suspend, Suspension
from cellapp.run import RunFile
from cellapp.trials.campaigns.doubles import ProgramKilled
from cellapp.trials.campaigns.faults import Fault, draw_faults
from cellapp.trials.campaigns.oracle import ArmEstimate, judge
from cellapp.trials.campaigns.world import SimulatedControl, World
from cellapp.trials.coverage import bare_profile
from drivers.sensors.simulated_settings import SimulatedAirSensorSettings

Plan = Mapping[str, NDArray[np.float64]]
"""Arm -> joint positions (n, N) [rad] of the planned stops and the reserves after them."""
Ended = Literal["complete", "accurate enough", "stopped", "aborted", "failed", "killed"]

STOPS_TO_A_FAULT = 8
"""Mean number of stops between two faults."""
RESERVE = 20
_MOST_SESSIONS_TO_A_FAULT = 3
_AIR_C = (10.0, 30.0)
"""Far from the plant's air, so that only a fault leaves it."""


@dataclass(frozen=True)
class Campaign:
    """What became of one campaign.

    Attributes
    ----------
    failures : tuple of str
        What must not be, and was; empty for a campaign as it should be.
    struck : mapping
        Fault -> how often it struck while a program ran.
    ended : mapping
        How sessions ended -> how often.
    digest : str
        SHA-256 of all events: equal for equal campaigns.
    """

    seed: int
    failures: tuple[str, ...]
    seconds: float
    simulated_s: float
    struck: Mapping[str, int]
    ended: Mapping[str, int]
    holds: int
    suspensions: int
    readings: int
    missing: int
    clearance_m: float
    digest: str


def campaign_profile(profile: Profile, stops: int) -> Profile:
    """Return the simulated cell of ``profile`` with ``stops`` stops and a weather station, without hidden effects.

    Effects that depend on the direction of approach would make a disturbed campaign differ from an undisturbed one.
    Raises ``InputError`` if the profile has no simulated cell.
    """
    bare = bare_profile(profile, stops)
    if not bare.tracker.driver.needs_plant or not all(arm.driver.needs_plant for arm in bare.arms.values()):
        raise InputError(f"profile {profile.name}: campaigns need drivers of kind 'simulated' for all devices")
    plan = bare.plan.model_copy(update={"reserve": RESERVE})
    sensors = bare.sensors.model_copy(update={"air": SimulatedAirSensorSettings()})
    return bare.model_copy(update={"plan": plan, "sensors": sensors})


def drawn_collection(rng: np.random.Generator) -> Collection:
    """Return how a campaign collects: references, limits, what may be waited for."""
    return Collection(
        reference=Reference(every=int(rng.choice([0, 0, 25, 60])), drift=200e-6),
        air=AirLimits(temperature=_AIR_C),
        suspend=Suspend(
            target=Suspension(times=int(rng.integers(0, 12)), wait=20.0, retry=2.0),
            air=Suspension(times=int(rng.integers(0, 4)), wait=600.0, retry=30.0),
            tracker_warm_up=Suspension(times=int(rng.integers(0, 4)), wait=200.0, retry=10.0),
            host_stall=Suspension(times=int(rng.integers(0, 3)), wait=30.0, retry=1.0),
        ),
        tolerated=1.0,
    )


@dataclass
class _Sessions:
    """How the sessions of a campaign ended."""

    ended: dict[str, int] = field(default_factory=dict)
    last: str = ""
    reason: str = ""

    def count(self, word: Ended, reason: str = "") -> None:
        self.ended[word] = self.ended.get(word, 0) + 1
        self.last, self.reason = word, reason


def run_campaign(
    profile: Profile, plan: Plan, seed: int, folder: Path, undisturbed: Mapping[str, ArmEstimate] | None
) -> tuple[Campaign, dict[str, ArmEstimate]]:
    """Run the campaign of a seed in an empty folder; return what became of it, and the identified arms.

    ``undisturbed`` is what the campaign without faults identified; None runs that campaign.
    """
    began_s = time.perf_counter()
    rng = np.random.default_rng([seed, 0])
    collection = drawn_collection(rng)
    stops = profile.plan.stops
    faults: tuple[Fault, ...] = ()
    if undisturbed is not None:
        count = max(1, int(rng.poisson(stops / STOPS_TO_A_FAULT)))
        faults = draw_faults(rng, tuple(profile.arms), stops, count)
    profile = profile.model_copy(update={"collection": collection})
    RunFile.create(folder / "run", profile, lambda run: run.write_plan(plan)).close()
    world = World(profile, seed, folder)
    world.expect(faults)
    sessions = _Sessions()
    most = 10 + _MOST_SESSIONS_TO_A_FAULT * len(faults)
    while sessions.last not in ("complete", "accurate enough") and sum(sessions.ended.values()) < most:
        if sessions.last:
            world.plant.advance(world.person.delay_s())
            world.repair()
        _session(world, sessions, SimulatedControl(holds=bool(rng.random() < 0.6)))
    with RunFile.open(world.run_folder) as run:
        found = judge(world, run, plan, sessions.last, undisturbed)
    failures = found.failures
    if sessions.last not in ("complete", "accurate enough"):
        failures = (*failures, f"not complete after {most} sessions; the last {sessions.last}: {sessions.reason}")
    campaign = Campaign(
        seed=seed,
        failures=failures,
        seconds=time.perf_counter() - began_s,
        simulated_s=world.plant.clock_s,
        struck=dict(world.struck),
        ended=sessions.ended,
        holds=world.monitor.counts["stopped"],
        suspensions=world.monitor.counts["suspended"],
        readings=found.readings,
        missing=found.missing,
        clearance_m=found.clearance_m,
        digest=world.monitor.digest(),
    )
    return campaign, found.estimates


def _session(world: World, sessions: _Sessions, control: JobControl) -> None:
    """Run the program once."""
    run = world.begin(control)
    try:
        resume = bool(sessions.last)
        summary = collect_run(run, world.person.hear, control, resume=resume, opened=world.opened)
        sessions.count(summary.outcome)
    except ProgramKilled:
        sessions.count("killed")
    except Aborted:
        sessions.count("aborted")
    except Stopped:
        sessions.count("stopped")
    except CellappError as error:
        sessions.count("failed", str(error))
    finally:
        world.end(run)
