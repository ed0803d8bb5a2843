"""Estimated time of collecting a plan: motions, rests, measurements, references, warm-up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.cell.planning.planned_stops import Configuration, PlannedStops, Route
from cellapp.cell.planning.records import PlannedTime
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import joint_rates

_SETTLE_S = 0.2
"""Rest after a motion before an arm counts as settled: the default of UR controllers and of simulated arms."""
_POINTING_S = 1.0
"""Time for the tracker to turn to the next SMR and to lock it; its head turns a quarter in half a second."""


@dataclass(frozen=True, eq=False)
class StopTimes:
    """Expected times of n stops.

    Attributes
    ----------
    moving_s, resting_s : arrays, shape (n,)
        Of the motion to each stop, and of the rest before its measurement [s].
    measuring_s : float
        Of all arms at one stop [s].
    """

    moving_s: Array
    resting_s: Array
    measuring_s: float

    @property
    def measured_s(self) -> Array:
        """When each stop is measured, in seconds since the first motion, shape (n,)."""
        return np.cumsum(self.moving_s + self.resting_s + self.measuring_s) - 0.5 * self.measuring_s


def motion_s(arm: Arm, way: Array) -> Array:
    """Compute the time of joint motions ``way`` (n, N) [rad] from rest to rest, shape (n,) [s].

    All joints start and end together, with a trapezoidal speed profile inside the arm's speeds and accelerations.
    """
    speed, acceleration = joint_rates(arm)
    at_speed = np.abs(way / speed).max(axis=1)
    at_acceleration = np.abs(way / acceleration).max(axis=1)
    # with ramps of a / v each: distance 1 = v * (T - a / v), or a triangle where full speed is never reached
    triangle = at_speed**2 < at_acceleration
    ramp = np.divide(at_acceleration, at_speed, out=np.zeros_like(at_speed), where=at_speed > 0.0)
    return np.asarray(np.where(triangle, 2.0 * np.sqrt(at_acceleration), at_speed + ramp))


def stop_times_of(profile: Profile, stops: PlannedStops) -> StopTimes:
    """Estimate the times of planned stops with their approaches and detours, from home."""
    here = home_positions(profile)
    begin = {
        name: np.where(np.isfinite(stops.approach_from[name]), stops.approach_from[name], q)
        for name, q in stops.q.items()
    }
    moving_s = np.max(
        [_straight_s(profile.arms[name], here.get(name), q, begin[name]) for name, q in stops.q.items()], axis=0
    )
    motions = np.ones(len(stops))
    last_s = np.max([motion_s(profile.arms[name], q - begin[name]) for name, q in stops.q.items()], axis=0)
    for stop, legs in enumerate(stops.legs):
        if legs:
            before = stops.targets(stop - 1) if stop else here
            moving_s[stop] = route_s(profile, before, (*legs, {name: q[stop] for name, q in begin.items()}))
            motions[stop] += len(legs)
    slow = profile.collection.slow_start
    moving_s += last_s
    if profile.moves_hardware:
        moving_s[: slow.stops] /= slow.speed
    dwell_s = np.max([stops.dwell_s[name] for name in stops.q], axis=0)
    resting_s = np.maximum(_SETTLE_S, dwell_s) + _SETTLE_S * (motions - 1.0 + (last_s > 0.0))
    return StopTimes(moving_s, resting_s, _measuring_s(profile) * len(stops.q))


def home_s(profile: Profile, stops: PlannedStops) -> float:
    """Compute the time of the motion home from the last stop [s]; 0 for arms without a home position."""
    homes = home_positions(profile)
    ways = [motion_s(profile.arms[name], (homes[name] - q[-1])[None]) for name, q in stops.q.items() if name in homes]
    return float(np.max(ways)) if ways else 0.0


def route_s(profile: Profile, start: Configuration, route: Route) -> float:
    """Compute the time of consecutive motions from ``start`` (all arms) [s]; each takes as long as its slowest arm."""
    here, total = dict(start), 0.0
    for targets in route:
        total += max(float(motion_s(profile.arms[name], (q - here[name])[None])[0]) for name, q in targets.items())
        here.update(targets)
    return total


def _straight_s(arm: Arm, start: Array | None, q: Array, begin: Array) -> Array:
    """Compute the time from each stop to where the next last motion begins, (n,) [s]; 0 from unknown ``start``."""
    first = begin[:1] if start is None else start[None]
    return motion_s(arm, begin - np.concatenate([first, q])[: len(q)])


def planned_time(profile: Profile, stops: PlannedStops) -> PlannedTime:
    """Estimate the time of collecting planned stops and going home."""
    times = stop_times_of(profile, stops)
    reference = profile.collection.reference
    references_s = 0.0
    if reference.every > 0:
        count = 2 + (len(times.moving_s) - 1) // reference.every
        points = len(stops.q) + len(reference.nests)
        references_s = count * (2.0 * float(np.mean(times.moving_s)) + points * _measuring_s(profile))
    parts = {
        "moving_s": float(times.moving_s.sum()) + home_s(profile, stops),
        "resting_s": float(times.resting_s.sum()),
        "measuring_s": times.measuring_s * len(times.moving_s),
        "references_s": references_s,
        "warm_up_s": profile.collection.warm_up,
    }
    return PlannedTime(total_s=sum(parts.values()), **parts)


def _measuring_s(profile: Profile) -> float:
    """Return the time of pointing at one SMR and measuring it, twice if repeats are required."""
    return _POINTING_S + (2 if profile.collection.repeat.precision is not None else 1) * profile.tracker.averaging
