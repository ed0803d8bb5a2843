"""One campaign: sessions of the real engine in a world of faults until the run is complete, then the judgement."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.run import RunFile
from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.ground.control import Aborted, Stopped
from cellapp.ground.errors import CellappError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import AirLimits, Collection, Reference, Suspend, Suspension
from drivers.sensors.simulated_settings import SimulatedAirSensorSettings
from tests.evidence.campaigning.doubles import ProgramKilled
from tests.evidence.campaigning.faults import Fault, sample_faults
from tests.evidence.campaigning.monitor import Failure
from tests.evidence.campaigning.oracle import ArmEstimate, judge
from tests.evidence.campaigning.world import Endless, SimulatedControl, World
from tests.evidence.shared.cells import bare
from tests.twin import altered
from tests.verbs import collect_by

Plan = Mapping[str, NDArray[np.float64]]
"""Arm -> joint positions (n, N) [rad] of the planned stops and the reserves after them."""
Targets = Mapping[str, NDArray[np.float64]]
"""Arm -> joint positions (N,) [rad]."""

STOPS_TO_A_FAULT = 8
"""Mean number of stops between two faults."""
RESERVE = 20
"""Reserve stops: some SMRs stay lost for longer than a campaign waits for them."""
_SESSIONS_TO_A_FAULT = 3
"""More sessions than this to a fault mean that the program does not get on."""
_ATTENDED = 0.6
"""Share of sessions that a person attends, who resumes after a stop; others end and are started again."""
_AIR_C = (10.0, 30.0)
"""Far from the plant's air, so that only a fault leaves it."""


@dataclass(frozen=True)
class Campaign:
    """What became of one campaign.

    Attributes
    ----------
    failures : tuple of Failure
        What must not be, and was; empty for a campaign as it should be.
    struck : mapping
        Fault -> how often it struck while a program ran.
    seconds : float
        Processor time, in one thread [s].
    digest : str
        SHA-256 of all events: equal for equal campaigns.
    """

    seed: int
    failures: tuple[Failure, ...]
    seconds: float
    simulated_s: float
    struck: Mapping[str, int]
    readings: int
    missing: int
    digest: str


def campaign_profile(profile: Profile, stops: int) -> Profile:
    """Return the simulated cell of ``profile`` with ``stops`` stops and a weather station, without hidden effects.

    Effects that depend on the direction of approach would make a disturbed campaign differ from an undisturbed one.
    Raises ``InputError`` if the profile has no simulated cell.
    """
    if profile.plant is None:
        raise InputError(f"profile {profile.name}: campaigns need a section 'plant' (a simulated cell)")
    own = bare(profile, stops)
    if not own.tracker.driver.needs_plant or not all(arm.driver.needs_plant for arm in own.arms.values()):
        raise InputError(f"profile {profile.name}: campaigns need drivers of kind 'simulated' for all devices")
    return altered(own, plan={"reserve": RESERVE}, sensors={"air": SimulatedAirSensorSettings()})


def sampled_collection(rng: np.random.Generator) -> Collection:
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


@dataclass(frozen=True, eq=False)
class RememberingGate:
    """The gate of one cell, whose answers depend on the ends of a motion only: it checks each motion once."""

    answers: dict[bytes, str] = field(default_factory=dict)

    def __call__(self, cell: CellBodies, q_from: Targets, q_to: Targets) -> str:
        """Return why the arms must not move; empty if they may."""
        key = b"".join(q[name].tobytes() for q in (q_from, q_to) for name in cell.arms)
        if key not in self.answers:
            self.answers[key] = refuse_motion(cell, q_from, q_to)
        return self.answers[key]


@dataclass(frozen=True, eq=False)
class Bench:
    """What all campaigns share: the cell, its planned stops, and what the campaign without faults identified."""

    profile: Profile
    plan: Plan
    undisturbed: Mapping[str, ArmEstimate] | None = None
    gate: RememberingGate = field(default_factory=RememberingGate)


def make_bench(profile: Profile, stops: int) -> Bench:
    """Plan the stops of ``profile`` and run the campaign without faults.

    Raises ``InputError`` if the profile has no simulated cell, or ``CellappError`` if already that campaign fails.
    """
    bare = campaign_profile(profile, stops)
    bench = Bench(bare, plan_stops(bare))
    campaign, estimates = run_campaign(bench, 0)
    if campaign.failures:
        raise CellappError(f"trials campaigns: the campaign without faults failed: {campaign.failures[0]}")
    return replace(bench, undisturbed=estimates)


def run_campaign(bench: Bench, seed: int) -> tuple[Campaign, dict[str, ArmEstimate]]:
    """Run the campaign of a seed; return what became of it, and the identified arms.

    A bench without ``undisturbed`` gets no faults. The run file is in memory, where the system has such a folder.
    """
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with TemporaryDirectory(prefix="campaign-", dir=memory) as folder:
        began_s = time.process_time()
        campaign, estimates = _run(bench, seed, Path(folder))
        return replace(campaign, seconds=time.process_time() - began_s), estimates


def _run(bench: Bench, seed: int, folder: Path) -> tuple[Campaign, dict[str, ArmEstimate]]:
    rng = np.random.default_rng([seed, 0])
    stops, arms = bench.profile.plan.stops, tuple(bench.profile.arms)
    profile = bench.profile.model_copy(update={"collection": sampled_collection(rng)})
    faults: tuple[Fault, ...] = ()
    if bench.undisturbed is not None:
        faults = sample_faults(rng, arms, stops, max(1, int(rng.poisson(stops / STOPS_TO_A_FAULT))))
    RunFile.create(folder / "run", profile, lambda run: run.write_plan(bench.plan)).close()
    world = World(profile, seed, folder, bench.gate)
    world.expect(faults)
    problems = _sessions(world, rng, 10 + _SESSIONS_TO_A_FAULT * len(faults))
    with RunFile.open(world.run_folder) as run:
        found = judge(world, run, bench.plan, bench.undisturbed, problems)
    campaign = Campaign(
        seed=seed,
        failures=found.failures,
        seconds=0.0,
        simulated_s=world.plant.clock_s,
        struck=dict(world.struck),
        readings=found.readings,
        missing=found.missing,
        digest=world.monitor.digest(),
    )
    return campaign, found.estimates


def _sessions(world: World, rng: np.random.Generator, most: int) -> tuple[Failure, ...]:
    """Run the program again and again until all is collected; return what nobody expects."""
    ended = reason = ""
    for number in range(most):
        if number:
            world.plant.advance(world.person.delay_s())
            world.repair()
        try:
            ended, reason = _session(world, SimulatedControl(holds=bool(rng.random() < _ATTENDED)), resume=number > 0)
        except Endless:
            return (Failure("other", f"does not end; simulated time is {world.plant.clock_s:.0f} s"),)
        except Exception as error:  # noqa: BLE001 - whatever the engine raises is a finding, and others go on
            where = traceback.extract_tb(error.__traceback__)[-1]
            text = f"unexpected {type(error).__name__}: {error} ({Path(where.filename).name}, line {where.lineno})"
            return (Failure("other", text),)
        if ended in ("complete", "accurate enough"):
            return ()
    return (Failure("other", f"not complete after {most} sessions; the last {ended}: {reason}"),)


def _session(world: World, control: SimulatedControl, *, resume: bool) -> tuple[str, str]:
    """Run the program once; return how it ended, and the reason of a failure."""
    run = world.begin(control)
    try:
        with control.heard_by(lambda event, _: world.person.hear(event)):
            return collect_by(world.opened, run, control, resume=resume).outcome, ""
    except ProgramKilled:
        return "killed", ""
    except Aborted:
        return "aborted", ""
    except Stopped:
        return "stopped", ""
    except CellappError as error:
        return "failed", str(error)
    finally:
        world.end(run)
