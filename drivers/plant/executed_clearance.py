"""Distances between the arms over all executed motions: a collision check afterwards, with few samples.

The bodies are placed at coarse times. Between two of them a distance can shrink only by the travel of both bodies.
Where that could bring them near each other, finer times are sampled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from drivers.plant.clearance import Clearance, segment_distances
from drivers.plant.config import Array, PlantConfig
from drivers.plant.mechanism import Mechanism, Posture
from drivers.plant.motion import AnyMotion
from drivers.plant.transforms import transform_points

_COARSE_S = 0.1
_FINE_S = 0.005
"""Fine sampling step: arms travel some millimetres in this time."""
_PAIRS_AT_ONCE = 100_000
"""Pairs of bodies per batch, which limits memory to some ten MB."""


class MovedArms(Protocol):
    """The part of a plant's interface that motions of its arms need."""

    config: PlantConfig

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arms."""

    def true_mechanism(self, name: str) -> Mechanism:
        """Return the true mechanism of an arm."""

    def true_T_C_B(self, name: str) -> Array:
        """Return the true pose of an arm's base."""


@dataclass(frozen=True, eq=False)
class Executed:
    """The part of a motion until ``end_s`` [s] that an arm executed."""

    motion: AnyMotion
    end_s: float


@dataclass(frozen=True, eq=False)
class _Bodies:
    """Capsules (k) of an arm at times (n): ends (k, n, 3) in C, radii (k,), travel (k, n - 1) between the times [m]."""

    starts: Array
    ends: Array
    radii: Array
    ways: Array
    movable: np.ndarray


def executed_clearance(plant: MovedArms, executed: Mapping[str, Sequence[Executed]], below_m: float) -> Clearance:
    """Return the smallest distances [m] during executed motions (arm -> in order); exact where below ``below_m``."""
    clearance = Clearance()
    times = _times(executed, _COARSE_S)
    if len(times) > 1:
        gaps = _watch(plant, executed, times, below_m, clearance)
        fine = [_within(times[k], times[k + 1]) for k in np.flatnonzero(gaps)]
        if fine:
            _watch(plant, executed, np.unique(np.concatenate(fine)), below_m, clearance)
    return clearance


def _within(start_s: float, end_s: float) -> Array:
    """Return times at most ``_FINE_S`` apart between two times, including both."""
    return np.linspace(start_s, end_s, max(int(np.ceil((end_s - start_s) / _FINE_S)), 1) + 1)


def _times(executed: Mapping[str, Sequence[Executed]], step_s: float) -> Array:
    """Return the times at which any motion starts or ends, and times at most ``step_s`` apart during motion."""
    spans = sorted((one.motion.start_s, one.end_s) for ways in executed.values() for one in ways)
    changes = np.unique(np.array(spans))
    if len(changes) < 2:
        return changes
    starts, latest = np.array([span[0] for span in spans]), np.maximum.accumulate([span[1] for span in spans])
    moving = latest[np.searchsorted(starts, changes[:-1], side="right") - 1] > changes[:-1]
    counts = np.where(moving, np.ceil(np.diff(changes) / step_s), 1).astype(int)
    parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(changes, changes[1:], counts, strict=False)]
    return np.append(np.concatenate(parts), changes[-1])


def _positions(executed: Sequence[Executed], home: Array, times: Array) -> Array:
    """Return the joint angles (n, N) of an arm at ascending times (n,)."""
    q = np.empty((len(times), len(home)))
    bounds = np.searchsorted(times, [one.motion.start_s for one in executed])
    q[: bounds[0] if len(bounds) else None] = home
    for one, first, last in zip(executed, bounds, np.append(bounds[1:], len(times)), strict=True):
        if first < last:
            q[first:last] = one.motion.position(np.minimum(times[first:last], one.end_s))
    return q


def _levers(mechanism: Mechanism) -> Array:
    """Return upper bounds (k, N) on the distance of any point of a capsule from each axis, for all joint angles [m].

    Successive axis points lie on one body, so their distances are constant; the bound is the path length along them.
    """
    points, capsules = mechanism.points, mechanism.capsules
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    last = np.maximum(capsules.frames - 1, 0)
    ends = np.stack([capsules.starts, capsules.ends])
    reach = np.linalg.norm(ends - points[last], axis=2).max(axis=0) + capsules.radii + along[last]
    carried = capsules.frames[:, None] > np.arange(len(points))
    levers: Array = np.where(carried, reach[:, None] - along, 0.0)
    return levers


def _placed(plant: MovedArms, name: str, executed: Sequence[Executed], times: Array) -> _Bodies:
    mechanism, T_C_B = plant.true_mechanism(name), plant.true_T_C_B(name)
    home = next(arm.home for arm in plant.config.arms if arm.name == name)
    assert home is not None
    q = _positions(executed, home, times)
    capsules = mechanism.capsules
    starts, ends = (transform_points(T_C_B, end) for end in Posture(mechanism, q, np.zeros(3)).segments())
    ways: Array = _levers(mechanism) @ np.abs(np.diff(q, axis=0)).T
    return _Bodies(starts, ends, capsules.radii, ways, capsules.frames > 0)


def _watch(
    plant: MovedArms, executed: Mapping[str, Sequence[Executed]], times: Array, below_m: float, clearance: Clearance
) -> np.ndarray:
    """Update ``clearance`` at ascending times (n,); return a mask (n - 1,) of intervals possibly below ``below_m``."""
    bodies = [_placed(plant, name, executed[name], times) for name in plant.names]
    doubtful = np.zeros(len(times) - 1, dtype=bool)
    for arm in bodies:
        heights = np.minimum(arm.starts, arm.ends)[arm.movable, :, 2] - arm.radii[arm.movable, None]
        heights -= plant.config.floor
        clearance.update_floor(heights, times)
        doubtful |= (_least(heights, arm.ways[arm.movable]) < below_m).any(axis=0)
    for i, one in enumerate(bodies):
        for other in bodies[i + 1 :]:
            doubtful |= _between(one, other, times, below_m, clearance)
    return doubtful


def _least(distances: Array, ways: Array) -> Array:
    """Return lower bounds (..., n - 1) of ``distances`` (..., n) between times, given changes of at most ``ways``."""
    least: Array = 0.5 * (distances[..., :-1] + distances[..., 1:] - ways)
    return least


def _between(one: _Bodies, other: _Bodies, times: Array, below_m: float, clearance: Clearance) -> np.ndarray:
    """Update ``clearance`` with the distances of two arms; return a mask (n - 1,) of where they may be too small."""
    along = other.starts[0, 0] - one.starts[0, 0]
    along = along / max(float(np.linalg.norm(along)), 1e-12)
    reach = (np.maximum(one.starts @ along, one.ends @ along) + one.radii[:, None]).max(axis=0)
    start = (np.minimum(other.starts @ along, other.ends @ along) - other.radii[:, None]).min(axis=0)
    ways = one.ways.max(axis=0) + other.ways.max(axis=0)
    near = np.flatnonzero(_least(start - reach, ways) < below_m)
    doubtful = np.zeros(len(times) - 1, dtype=bool)
    block = max(1, _PAIRS_AT_ONCE // (len(one.radii) * len(other.radii)))
    for first in range(0, len(near), block):
        chosen = near[first : first + block]
        at = np.union1d(chosen, chosen + 1)
        a, b, c, d = (ends[:, at] for ends in (one.starts, one.ends, other.starts, other.ends))
        gaps = segment_distances(a[:, None], b[:, None], c[None], d[None])
        gaps -= (one.radii[:, None] + other.radii)[..., None]
        clearance.update_arms(gaps, times[at])
        k = np.searchsorted(at, chosen)
        least = 0.5 * (gaps[..., k] + gaps[..., k + 1] - one.ways[:, None, chosen] - other.ways[None, :, chosen])
        doubtful[chosen] = (least < below_m).any(axis=(0, 1))
    return doubtful
