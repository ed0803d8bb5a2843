"""Compute the characteristics of a path, AT, RT and velocity, from points measured along it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellapp.estimation.iso9283.characteristics import (
    FEWEST_CYCLES,
    coverage_of_mean,
    plane_crossings,
    speeds,
    velocity_accuracy,
    velocity_fluctuation,
    velocity_repeatability,
)
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.records import PathCharacteristics, PathVelocity
from cellapp.estimation.iso9283.uncertainty import path_values
from cellapp.robot.kinematics.transforms import Array

_SAME_STRETCH_M = 0.02
"""Distance up to which a crossing belongs to its point: no arm is farther off, but the far side of a closed path is."""
_MIDDLE = (0.25, 0.75)
"""Shares of a path's length between which the velocity is evaluated: no ramp reaches there."""
_DRAWS = 200


@dataclass(frozen=True, eq=False)
class PathTrack:
    """Measured points of one cycle along a path: times (k,) [s] and positions (k, 3) [m], in order.

    ``lost_beams`` is the number of earlier attempts at the cycle that ended because the beam broke.
    """

    time_s: Array
    p_M: Array
    lost_beams: int = 0


@dataclass(frozen=True, eq=False)
class PathRuns:
    """Path that was driven several times.

    Attributes
    ----------
    arm, commands, name : str
    speed : float
        Commanded speed [m/s].
    length : float
        Length of the path [m].
    commanded_M, tangents_M : array, shape (m, 3)
        Points on the commanded path [m], and its unit tangents there.
    s : array, shape (m,)
        Arc lengths of these points [m].
    tracks : list of PathTrack
        One for each cycle.
    tracker, frame : array, shape (3, 3)
        Covariances as in ``Cycles`` [m^2].
    wanted : int
        Requested number of cycles.
    slowed : str
        Why the planned motion does not keep the commanded speed; empty if it does.
    series : float
        Share of the profile's speed if the test is repeated at another speed, else 0.
    problems : list of str
        Why fewer cycles were driven.
    """

    arm: str
    commands: IsoCommands
    name: str
    speed: float
    length: float
    commanded_M: Array
    tangents_M: Array
    s: Array
    tracks: list[PathTrack]
    tracker: Array
    frame: Array
    wanted: int
    slowed: str = ""
    series: float = 0.0
    problems: list[str] = field(default_factory=list)


def path_characteristics(runs: PathRuns, rng: np.random.Generator) -> PathCharacteristics | None:
    """Compute velocity, and AT and RT over the points whose planes every cycle crossed; None with fewer than
    two cycles."""
    if len(runs.tracks) < FEWEST_CYCLES:
        return None
    crossed = np.stack([_crossings(runs, one) for one in runs.tracks], axis=1)
    kept = np.isfinite(crossed).all(axis=(1, 2))
    if not kept.any():
        return None
    places = crossed[kept, :, :3]
    accuracy, repeatability = path_values(places, runs.commanded_M[kept], runs.tracker, runs.frame, rng)
    return PathCharacteristics(
        path=runs.name,
        speed_mm_s=runs.speed * 1e3,
        length_mm=runs.length * 1e3,
        points=int(kept.sum()),
        accuracy=accuracy,
        repeatability=repeatability,
        velocity=_velocity(runs, crossed[:, :, 3].T, rng),
        slowed=runs.slowed,
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _crossings(runs: PathRuns, track: PathTrack) -> Array:
    """Compute where and when one cycle crosses the planes at the points, (m, 4) [m, s]; NaN where it does not."""
    return plane_crossings(
        np.column_stack([track.p_M, track.time_s]), runs.commanded_M, runs.tangents_M, _SAME_STRETCH_M
    )


def _velocity(runs: PathRuns, times: Array, rng: np.random.Generator) -> PathVelocity | None:
    """Compute AV, RV and FV over the middle half of a path; None if a plane there was not crossed."""
    middle = (runs.s >= _MIDDLE[0] * runs.length) & (runs.s <= _MIDDLE[1] * runs.length)
    if middle.sum() < 3 or not np.isfinite(times[:, middle]).all():
        return None
    n, s = len(times), runs.s[middle]
    found = speeds(times[:, middle], s)
    sigma_m = float(np.sqrt(np.einsum("ma,ab,mb->m", runs.tangents_M, runs.tracker, runs.tangents_M).mean()))
    noise_s = sigma_m / runs.speed * rng.standard_normal((_DRAWS, 1, len(s)))
    even = (s - s[0]) / runs.speed
    alone = [velocity_fluctuation(speeds(even + noise, s)) for noise in noise_s]
    scatter = velocity_repeatability(found, runs.speed) / 3.0
    return PathVelocity(
        accuracy_percent=1e2 * velocity_accuracy(found, runs.speed),
        expanded_percent=1e2 * coverage_of_mean(n) * scatter,
        repeatability_percent=3e2 * scatter,
        fluctuation_mm_s=1e3 * velocity_fluctuation(found),
        tracker_fluctuation_mm_s=1e3 * float(np.mean(alone)),
        n=n,
    )
