"""The world of one campaign: the devices, the disk, the person, and the program that runs in it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from cellapp.cell.driving.cell import Cell, build_plant, one_by_one, start_tracker
from cellapp.cell.driving.requests import answer_to
from cellapp.cell.driving.tracker_watch import Died, unwatched
from cellapp.cell.safety.gate import Gate, refuse_motion
from cellapp.ground.control import JobControl, Request
from cellapp.ground.errors import HardwareError
from cellapp.ground.job_client import Verb
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Progress, StateChange
from drivers.arms.protocol import Arm, ArmError
from drivers.clock import SimulatedClock, Sleep
from drivers.plant import Plant
from drivers.sensors.protocol import SensorError
from drivers.trackers.protocol import Tracker
from tests.evidence.campaigning.disk import CampaignRun, Disk, copy_run
from tests.evidence.campaigning.doubles import (
    CampaignAir,
    CampaignArm,
    CampaignTracker,
    Guarded,
    Process,
    ProgramKilled,
)
from tests.evidence.campaigning.faults import KINDS, Fault
from tests.evidence.campaigning.monitor import Monitor

_MOST_S = 7200.0
"""Longest campaign without faults, and longest delay by one fault [s]."""
_COMES_S = (2.0, 60.0)
"""Earliest and latest time at which the person is there after an alarm."""


class World:
    """Everything around the engine. Time passes in ``plant`` only."""

    def __init__(self, profile: Profile, seed: int, folder: Path, gate: Gate = refuse_motion) -> None:
        self._gate = gate
        self.plant = build_plant(profile, watch_clearance=True)
        self.monitor = Monitor(self.plant)
        self.process = Process()
        self.arms = {name: CampaignArm(self.plant, name, self.monitor) for name in profile.arms}
        self.tracker: CampaignTracker = CampaignTracker(self.plant, self.monitor)
        self.air = CampaignAir(self.plant)
        self.disk = Disk(self.plant, self.process, self.monitor, self.kill)
        self.person: Person = Person(self, np.random.default_rng([seed, 1]))
        self.stall_allowed = profile.collection.suspend.host_stall.times > 0
        self.struck: Counter[str] = Counter()
        self.is_open = False
        """Whether a program has the devices."""
        self._tracker_died: Died | None = None
        self._folder, self._copies = folder, 0
        self.run_folder = folder / "run"
        """Folder of the run; a copy after the program was killed."""

    def later(self, after_s: float, act: Callable[[], None]) -> None:
        """Do something ``after_s`` from now."""
        self.plant.schedule.at(self.plant.clock_s + after_s, act)

    def expect(self, faults: tuple[Fault, ...]) -> None:
        """Let all faults strike at their times, those that do while a program runs."""
        self.plant.schedule.at(_MOST_S * (1 + len(faults)), self._give_up)
        for fault in faults:
            self.plant.schedule.at(fault.at_s, partial(self._strike, fault))

    def _give_up(self) -> None:
        self.process.alive = False
        raise Endless

    def _strike(self, fault: Fault) -> None:
        if self.process.alive:
            self.struck[fault.kind] += 1
            self.monitor.note(fault.kind)
            KINDS[fault.kind](self, fault)

    def repair(self) -> None:
        """Do what a person does before resuming: release the arms, free the disk."""
        for arm in self.arms.values():
            arm.release()
        self.tracker.release()
        self.tracker.mute = False
        self.disk.state = "healthy"

    # -- the program ---------------------------------------------------------------------------------------------------

    def begin(self, control: JobControl) -> CampaignRun:
        """Start the program: the person allows motion by that. Returns its run file."""
        self.monitor.release("the program was started")
        self.process.alive = True
        self.person.control = control
        run = CampaignRun.open(self.run_folder, write=True)
        run.attach(self.disk)
        return run

    def end(self, run: CampaignRun) -> None:
        """The program has ended, or is dead."""
        if self.process.alive and not self.monitor.latched:  # else the monitor checks soon that all arms rest
            for name in self.plant.names:
                if self.plant.moving(name):
                    self.monitor.violation("motion after a stop", f"the program ended while arm {name} moved")
        self.process.alive = False
        self.person.control = None
        self.disk.dies = None
        for arm in self.arms.values():
            arm.forget_program()
        run.close()

    def kill(self) -> None:
        """Kill the program now: what is on the disk stays, and nothing else of it. Raises ``ProgramKilled``."""
        if not self.process.alive:
            return
        self.monitor.stop("the death of the program", unreachable=True)
        self.process.alive = False
        self._copies += 1
        copy = self._folder / f"run-{self._copies}"
        copy_run(self.run_folder, copy)
        self.run_folder = copy
        for arm in self.arms.values():
            arm.forget_program()
        raise ProgramKilled

    @contextmanager
    def opened(self, profile: Profile, **_: Any) -> Iterator[Cell]:
        """Connect to all devices, as ``open_cell`` does."""
        arms: dict[str, Any] = {name: Guarded(arm, self.process) for name, arm in self.arms.items()}
        tracker, air = (cast(Any, Guarded(device, self.process)) for device in (self.tracker, self.air))
        with ExitStack() as stack:
            try:
                for arm in arms.values():
                    stack.callback(_disconnect, arm)
                    arm.connect()
                stack.callback(lambda: tracker.disconnect())
                unmet = start_tracker(tracker, profile.tracker.driver)
                stack.callback(lambda: air.disconnect())
                air.connect()
            except (ArmError, SensorError) as error:
                raise HardwareError(str(error)) from error
            self.is_open = True
            stack.callback(setattr, self, "is_open", False)
            yield Cell(
                arms,
                tracker,
                HoldingClock(self.plant, self.person),
                partial(self._watched, tracker),
                air,
                together=one_by_one,
                tracker_unmet=unmet,
                gate=self._gate,
            )

    @contextmanager
    def _watched(self, tracker: Tracker, died: Died) -> Iterator[None]:
        """Tell the program of a tracker that is dead, or dies meanwhile."""
        self._tracker_died = died
        try:
            with unwatched(tracker, died):
                yield
        finally:
            self._tracker_died = None

    def tracker_dies(self) -> None:
        """The tracker was lost; the program hears of it now if it watches, else at its next measurement."""
        if self._tracker_died is not None:
            self.monitor.stop("a lost tracker")
            self._tracker_died("tracker: the simulated link is cut")


class HoldingClock(SimulatedClock):
    """The plant's clock, whose waits end at a person's stop as those in real time do.

    A job that holds for a person, and asks every moment, waits until something happens.
    """

    def __init__(self, plant: Plant, person: Person) -> None:
        super().__init__(plant)
        self._person = person

    def wait(self, duration_s: float, sleep: Sleep) -> None:
        """Advance the simulation, while the job holds to the next event."""
        if self._request() in ("pause", "stop") and math.isfinite(self.plant.undisturbed_s):
            self.plant.advance(max(duration_s, self.plant.undisturbed_s))
            return
        end_s = self.now_s() + duration_s
        while (remaining_s := end_s - self.now_s()) > 0.0:
            self.plant.advance(min(remaining_s, self.plant.undisturbed_s))
            if self._request() in ("stop", "abort"):
                return

    def _request(self) -> Request:
        control = self._person.control
        return "none" if control is None else control.request


class Endless(BaseException):
    """The campaign takes longer than any can."""


class SimulatedControl(JobControl):
    """A person's requests in simulated time: waiting for one takes no real time."""

    def wait_while(self, *requests: Request, timeout_s: float | None = None) -> Request:
        """Return the request that stands; the caller lets simulated time pass."""
        return self.request


def _disconnect(arm: Arm) -> None:
    with suppress(ArmError):
        arm.disconnect()


class Person:
    """Who attends the cell: asks the job, hears its alarms, repairs, resumes, and never gives up."""

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self._world, self._rng = world, rng
        self.control: JobControl | None = None
        self.asked: Counter[str] = Counter()
        """Requests that stopped arms which nothing else had stopped before."""
        self._coming = False

    def delay_s(self) -> float:
        """Return how long it takes until the person is there [s]."""
        return float(self._rng.uniform(*_COMES_S))

    def hear(self, event: Progress) -> None:
        """Come when the job says that it is stopped."""
        if not isinstance(event.detail, StateChange):
            return
        if event.detail.state == "stopped" and not self._coming:
            self._coming = True
            self._world.later(self.delay_s(), self._arrive)
        elif event.detail.state == "running" and self._world.stall_allowed:
            self._world.monitor.resumed_by_itself()

    def _arrive(self) -> None:
        self._coming = False
        self.resume()

    def pause(self, lasts_s: float) -> None:
        """Pause the job for a while."""
        if self.control is not None and self.control.request == "none":
            self._world.monitor.pause()
            self.control.pause()
            self._world.later(lasts_s, self.resume)

    def stop(self) -> None:
        """Stop all arms now."""
        if self.control is not None:
            self._count("stop")
            self._world.monitor.stop("a person's stop")
            self.control.stop()

    def ask_from_outside(self, verb: Verb) -> None:
        """Ask as another process does, by the words of its request."""
        if self.control is not None:
            self._count(verb)
            self._world.monitor.stop(f"a {verb} from another process")
            answer_to(self.control, verb)

    def _count(self, verb: str) -> None:
        """Count a request that a session in an open cell has to record."""
        if self._world.is_open and not self._world.monitor.latched:
            self.asked[verb] += 1

    def abort(self) -> None:
        """End the job now."""
        if self.control is not None:
            self._count("abort")
            self._world.monitor.stop("a person's abort")
            self.control.abort()

    def resume(self) -> None:
        """Look at everything, repair it, and let a job that waits go on."""
        if self.control is not None and self.control.request in ("stop", "pause"):
            self._world.repair()
            self._world.monitor.release("a person resumed")
            self.control.resume()
