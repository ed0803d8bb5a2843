"""Measure one SMR at a stop: repeat until the mean is precise enough, and wait while temporary causes prevent it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.driving.motion import Mover, Vector
from cellapp.cell.driving.supervision import Supervisor
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile.sections import Repeat
from cellapp.robot.kinematics.transforms import mean_rotation, quaternions_of, rotations_of
from drivers.trackers.protocol import (
    NotReady,
    Point,
    TargetLost,
    TrackerError,
    Unstable,
    WrongTarget,
)

Measure = Callable[[], Point]

_MISSED = (TargetLost, WrongTarget, Unstable)


@dataclass(frozen=True)
class SmrMeasurement:
    """Measures SMRs with the repeats and waits of a profile."""

    mover: Mover
    supervisor: Supervisor
    repeat: Repeat
    tracker_ready: Callable[[], bool]
    """Callback that connects and prepares the tracker again; returns whether it is ready then."""

    def at_arm(self, name: str, q: Vector) -> Point:
        """Measure the SMR of an arm at rest at ``q`` (N,) [rad]. Raise as ``Mover.measure``."""
        return self._precise(f"arm {name}", lambda: self.mover.measure(name, q))

    def at_nest(self, name: str, expected_M: Vector) -> Point:
        """Measure the SMR in a nest near ``expected_M`` (3,) [m]. Raise as ``Mover.measure``."""
        return self._precise(f"nest {name}", lambda: self.mover.measure_at(expected_M, f"nest {name}"))

    def _precise(self, what: str, measure: Measure) -> Point:
        """Repeat until the standard error of the mean is small enough, or the profile's maximum is reached."""
        first = self._patient(what, measure)
        if self.repeat.precision is None:
            return first
        points = [first]
        while len(points) < self.repeat.times:
            points.append(self._patient(what, measure))
            if _deviation_of_mean(points) <= self.repeat.precision:
                break
        return mean_point(points)

    def _patient(self, what: str, measure: Measure) -> Point:
        """Measure; if the SMR is missed or the tracker is not ready, wait as the profile allows and try again."""
        while True:
            try:
                return measure()
            except NotReady as error:
                if not self.supervisor.suspended("tracker_warm_up", str(error), self.tracker_ready):
                    raise HardwareError(f"{what}: {error}") from error
            except _MISSED as error:
                found = self._wait_for_target(what, error, measure)
                if found is None:
                    raise
                return found

    def _wait_for_target(self, what: str, error: TrackerError, measure: Measure) -> Point | None:
        found: list[Point] = []

        def ready() -> bool:
            try:
                found.append(measure())
            except (*_MISSED, NotReady):
                return False
            return True

        return found[0] if self.supervisor.suspended("target", f"{what}: {error}", ready) else None


def mean_point(points: list[Point]) -> Point:
    """Return the mean of repeated measurements of a resting SMR.

    Its covariance is that of one measurement, because repeats do not reduce all of the tracker's errors (angles,
    scale); ``precision_M`` is the standard error of the mean.
    """
    if len(points) == 1:
        return points[0]
    positions = np.array([point.p_M for point in points])
    first, last = points[0], points[-1]
    return replace(
        first,
        p_M=positions.mean(axis=0),
        time_s=0.5 * (first.time_s + last.time_s),
        averaging_s=last.time_s - first.time_s + 0.5 * (first.averaging_s + last.averaging_s),
        precision_M=positions.std(axis=0, ddof=1) / np.sqrt(len(points)),
        quality=tuple(dict.fromkeys(warning for point in points for warning in point.quality)),
        quaternion_M=_mean_quaternion([point.quaternion_M for point in points]),
    )


def _mean_quaternion(measured: Sequence[Vector | None]) -> Vector | None:
    """Return the mean orientation; None if one is missing."""
    quaternions = [one for one in measured if one is not None]
    if len(quaternions) < len(measured):
        return None
    return quaternions_of(mean_rotation(rotations_of(quaternions)))


def _deviation_of_mean(points: list[Point]) -> float:
    """Return the largest standard error of the mean over the coordinates [m]."""
    positions = np.array([point.p_M for point in points])
    return float((positions.std(axis=0, ddof=1) / np.sqrt(len(points))).max())
