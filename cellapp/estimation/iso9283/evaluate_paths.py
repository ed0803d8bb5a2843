"""From points that were measured along a path to its characteristics: AT, RT, velocity, corners."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cellapp.estimation.iso9283.along import (
    Corner,
    corner_overshoot,
    corner_rounding,
    speeds,
    velocity_accuracy,
    velocity_fluctuation,
    velocity_repeatability,
)
from cellapp.estimation.iso9283.characteristics import FEWEST_CYCLES, coverage_of_mean, plane_crossings
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.records import CornerCharacteristics, IsoValue, PathCharacteristics, PathVelocity
from cellapp.estimation.iso9283.uncertainty import path_values
from cellapp.robot.kinematics.transforms import Array

_SAME_STRETCH_M = 0.02
"""An arm is nowhere farther from its path; on a closed path the other side is."""
_MIDDLE = (0.25, 0.75)
"""Shares of a path's length between which its velocity counts: no ramp reaches there."""
_DRAWS = 200


@dataclass(frozen=True, eq=False)
class PathTrack:
    """Measured points of one cycle along a path: times (k,) [s] and positions (k, 3) [m], in order.

    ``lost_beams`` is how often the cycle was begun before and not ended, as the beam broke.
    """

    time_s: Array
    p_M: Array
    lost_beams: int = 0


@dataclass(frozen=True, eq=False)
class PathRuns:
    """A path that was driven several times.

    Attributes
    ----------
    arm, commands, name : str
    speed : float
        Commanded [m/s].
    length : float
        [m]
    commanded_M, tangents_M : array, shape (m, 3)
        Places on the commanded path [m], and its unit tangents there.
    s : array, shape (m,)
        Arc lengths of these places [m].
    tracks : list of PathTrack
        Of each cycle.
    tracker, frame : array, shape (3, 3)
        As in ``Cycles`` [m^2].
    wanted : int
        Cycles that were to be driven.
    corners : tuple of Corner
        Corners of the commanded path; where it has some, the arm does not keep its speed.
    slowed : str
        Why the programme itself does not keep the commanded speed; empty if it does.
    series : float
        Share of the profile's speed where the test is repeated at another one, else 0.
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
    corners: tuple[Corner, ...] = ()
    slowed: str = ""
    series: float = 0.0
    problems: list[str] = field(default_factory=list)


def path_characteristics(runs: PathRuns, rng: np.random.Generator) -> PathCharacteristics | None:
    """AT and RT over the places that every cycle crossed, velocity, corners; None with fewer than two cycles."""
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
        corners=tuple(_corner(runs, corner) for corner in runs.corners),
        slowed=runs.slowed,
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _crossings(runs: PathRuns, track: PathTrack) -> Array:
    """Where and when one cycle crosses the planes at the places, (m, 4) [m, s]; NaN where it does not."""
    return plane_crossings(
        np.column_stack([track.p_M, track.time_s]), runs.commanded_M, runs.tangents_M, _SAME_STRETCH_M
    )


def _velocity(runs: PathRuns, times: Array, rng: np.random.Generator) -> PathVelocity | None:
    """AV, RV and FV over the middle half of a path without corners; None where a place there was not crossed."""
    middle = (runs.s >= _MIDDLE[0] * runs.length) & (runs.s <= _MIDDLE[1] * runs.length)
    if runs.corners or middle.sum() < 3 or not np.isfinite(times[:, middle]).all():
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


def _corner(runs: PathRuns, corner: Corner) -> CornerCharacteristics:
    count = float(
        np.mean([(np.linalg.norm(one.p_M - corner.at_M, axis=1) <= corner.reach).sum() for one in runs.tracks])
    )
    return CornerCharacteristics(
        corner=corner.name,
        rounding=_mean_of(runs, corner, corner_rounding, 0.0),
        overshoot=_mean_of(runs, corner, corner_overshoot, float(np.sqrt(2.0 * np.log(max(count, 1.0))))),
    )


def _mean_of(
    runs: PathRuns, corner: Corner, formula: Callable[[Array, Corner], float], contained: float
) -> IsoValue | None:
    """The mean over the cycles that passed the corner; None with fewer than two.

    ``contained`` is the noise that the value may contain, in standard deviations of a coordinate: the largest of many
    points is larger than what it would be without noise.
    """
    values = np.array([formula(one.p_M, corner) for one in runs.tracks])
    values = values[np.isfinite(values)]
    n = len(values)
    if n < FEWEST_CYCLES:
        return None
    sigma = float(np.sqrt(np.trace(runs.tracker + runs.frame) / 3.0))
    sampling = coverage_of_mean(n) * float(values.std(ddof=1))
    expanded = float(np.sqrt(sampling**2 + (2.0 * sigma) ** 2 + (contained * sigma) ** 2))
    return IsoValue(value_mm=1e3 * float(values.mean()), expanded_mm=1e3 * expanded, n=n)
