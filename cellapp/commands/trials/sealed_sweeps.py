"""Sweeps of sealed runs: planned once for many runs, recorded in each run's simulated cell."""

from __future__ import annotations

from dataclasses import dataclass

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.sweeping import CYCLE_S, calculated_streams
from cellapp.cell.planning.plan import make_stops
from cellapp.cell.planning.planned_stops import Configuration, PlannedStops
from cellapp.cell.planning.sweeps import PlannedSweep, plan_sweeps
from cellapp.cell.run.recordings_csv import RecordedStreams
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken
from drivers.plant import Plant
from drivers.plant.sweep import record_sweep, recorder_of

_SESSION = "sweeps"
"""Name of the one recording that holds all sweeps of an arm."""
_WAIT_S = 0.1


@dataclass(frozen=True, eq=False)
class SweepPlan:
    """Stops, and a sweep of each arm about each stop if gate and tracker allow it; the other arms rest."""

    stops: PlannedStops
    sweeps: tuple[PlannedSweep, ...]

    @classmethod
    def of(cls, profile: Profile, count: int, seed: int, cancel: CancelToken) -> SweepPlan:
        """Plan sweeps about ``count`` stops. Raises ``InputError`` if no arm can sweep anywhere, and ``Cancelled``."""
        plan = profile.plan.model_copy(update={"stops": count, "reserve": 0, "other_arm": "resting"})
        asked = profile.model_copy(update={"plan": plan, "seed": seed})
        stops, _ = make_stops(asked, cancel=cancel)
        return cls(stops, plan_sweeps(asked, stops, cancel=cancel).sweeps)

    def recorded(self, profile: Profile) -> list[RecordedStreams]:
        """Record the sweeps in the simulated cell of ``profile``, with its own clocks and devices."""
        plant, found = build_plant(profile), list[RecordedStreams]()
        recorder = recorder_of(plant)
        for sweep in self.sweeps:
            at = self.stops.targets(sweep.stop)
            _move(plant, at)
            motion = sweep.motion(at[sweep.arm])
            record = record_sweep(plant, recorder, sweep.arm, motion.at(motion.times(CYCLE_S)), CYCLE_S)
            found.append(calculated_streams(profile, (sweep.arm, sweep.name), record, None, _SESSION))
        return found


def _move(plant: Plant, at: Configuration) -> None:
    """Move all arms at once and wait until they rest."""
    for arm in plant.config.arms:
        plant.start_move(arm.name, at[arm.name], arm.speed, arm.acceleration)
    while any(plant.moving(name) for name in plant.names):
        plant.advance(_WAIT_S)
