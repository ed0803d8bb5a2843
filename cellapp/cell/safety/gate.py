"""The safety gate: conditions for every motion, used by planning, collection, compensation and the doctor.

A motion is a straight line in joint space. Two arms may move at any relative speed: every point of one arm's path is
checked against every point of the other's. The gate is fail-safe: it refuses whatever it cannot check.

Paths of arms as samples, with bounds on how far a body can be from its position at the nearest sample.

The answers of ``refuse_motion`` for many motions, in batches and without reasons.

In batches this takes a third of the time: a single motion spends most of it on calls for a few samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import (
    ArmBodies,
    Placed,
    TrackerField,
    beam_clearance,
    height_clearance,
    mounted_hides,
    pair_gaps,
    place,
    segment_distance,
    self_clearance,
    sight_conditions,
    sight_of,
)
from cellapp.cell.safety.shapes import ObstacleBody, beam_gaps
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array, rows_at

EVERY = 2
"""Stride of the samples that are checked against other arms, where all pairs of samples are compared. Other checks use
all samples. The coarser spacing is added to the clearance."""
STRIDE = 8
"""Stride of the coarse samples, which are checked first; a multiple of 2 * ``EVERY``."""


Bools = NDArray[np.bool_]
Numbers = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths of one arm from ``start`` to ``target`` (n, N) [rad], each as ``count`` (n,) evenly spaced samples.

    No point of a body is farther than ``deviation`` from where it is at the nearest sample. Most of a path is far from
    everything. Therefore every ``STRIDE``-th sample is checked first. Bodies are placed at the samples around it only
    where a body, displaced as far as possible, could come too near.
    """

    arm: ArmBodies
    start: Array
    target: Array
    count: Numbers

    @classmethod
    def of(cls, arm: ArmBodies, start: Array, target: Array, spacing: float) -> Paths:
        """Sample paths so that no point of a body moves more than ``spacing`` [m] in ``EVERY`` steps."""
        longest = np.abs(target - start) @ arm.levers
        count = np.asarray(EVERY * np.maximum(1, np.ceil(longest / spacing)) + 1, dtype=np.intp)
        return cls(arm, start, target, count)

    def take(self, rows: Numbers) -> Paths:
        """Select some of the paths, in their order, with those of their bodies that are placed already."""
        if len(rows) == len(self.count):
            return self
        some = Paths(self.arm, self.start[rows], self.target[rows], self.count[rows])
        if "coarse_bodies" in vars(self):
            kept = np.zeros(len(self.count), dtype=np.bool_)
            kept[rows] = True
            vars(some)["coarse_bodies"] = self.coarse_bodies.take(np.flatnonzero(kept[self.coarse[0]]))
        return some

    @cached_property
    def half_step(self) -> Array:
        """Largest motion of each joint from any point to the nearest sample, for each path (n, N) [rad]."""
        return np.asarray(np.abs(self.target - self.start) * (0.5 / (self.count - 1))[:, None])

    @cached_property
    def deviation(self) -> Array:
        """Largest displacement of any point of a body from its place at the nearest sample, for each path (n,) [m]."""
        return np.asarray(self.half_step @ self.arm.levers)

    @cached_property
    def coarse(self) -> tuple[Numbers, Numbers]:
        """Path and index of every ``STRIDE``-th sample and of the last one of all paths, (r,) each."""
        number = -(-(self.count - 1) // STRIDE) + 1
        path = np.repeat(np.arange(len(number)), number)
        place_in_path = np.arange(len(path)) - np.repeat(np.cumsum(number) - number, number)
        return path, np.minimum(STRIDE * place_in_path, self.count[path] - 1)

    @cached_property
    def coarse_bodies(self) -> Placed:
        """The bodies at the coarse samples."""
        return self.placed(*self.coarse)

    def placed(self, path: Numbers, sample: Numbers) -> Placed:
        """Place the bodies at some samples of some paths."""
        last = self.count[path] - 1
        share = np.where(sample == last, 1.0, sample * (1.0 / last))
        return place(self.arm, self.start[path] + share[:, None] * (self.target[path] - self.start[path]))

    def around(self, unclear: Bools, every: int = 1) -> tuple[Numbers, Numbers]:
        """Return path and index of every ``every``-th sample nearest to the ``unclear`` (r,) coarse samples."""
        path, sample = (part[unclear] for part in self.coarse)
        if not len(path):
            return path, sample
        near = np.clip(sample[:, None] + np.arange(-(STRIDE // 2), STRIDE // 2 + 1), 0, self.count[path, None] - 1)
        longest = int(self.count.max())
        both = np.unique(path[:, None] * longest + near)
        path, sample = both // longest, both % longest
        chosen = sample % every == 0
        return path[chosen], sample[chosen]


# -- Distances between two arms, at rest and on paths with any relative speed -----------------------------------------


_PAIRS_AT_ONCE = 20_000
"""Pairs of capsules in a batch: some MB of memory, and an early end at the first collision."""
_ROUNDING_M = 1e-6
"""Tolerance for rounding of distances between spheres, which are computed from squares [m]."""


def gap_at_rest(first: Placed, second: Placed, within: float) -> Array:
    """Compute distances (n,) [m] of two arms at n pairs of configurations; infinite beyond ``within`` [m]."""
    gaps = np.full(len(first.smr), np.inf)
    along = _between_bases(first, second)
    reach_first, reach_second = _reach(first, along), _reach(second, -along)
    # at each pair of configurations, bodies that reach past the other arm's nearest one
    near_first = ~(reach_first + reach_second.max(axis=1, keepdims=True) <= -within)
    near_second = ~(reach_second + reach_first.max(axis=1, keepdims=True) <= -within)
    rows, i, k = np.nonzero(near_first[:, :, None] & near_second[:, None, :])
    for begin in range(0, len(rows), _PAIRS_AT_ONCE):
        batch = slice(begin, begin + _PAIRS_AT_ONCE)
        r, a, b = rows[batch], i[batch], k[batch]
        ends, others = first.axes(r, a), second.axes(r, b)
        between = 0.5 * (ends[0] + ends[1] - others[0] - others[1])
        needed = first.arm.extents[a] + second.arm.extents[b] + within + _ROUNDING_M
        near = ~(np.einsum("cp,cp->p", between, between) > needed * needed)  # also for NaN
        gap = segment_distance(*(end[:, near].T for end in (*ends, *others)))
        np.minimum.at(gaps, r[near], gap - first.radius[a[near]] - second.radius[b[near]])
    return gaps


def gap_on_paths(first: Paths, second: Paths, clearance: float) -> tuple[float, float]:
    """Compute the distance of two arms at any relative speed on one path of each, and the allowance for samples [m].

    The distance is infinite if all pairs of samples keep ``clearance`` plus the allowance; else it is that of a pair
    that does not.
    """
    both = float(first.deviation[0] + second.deviation[0])
    allowance = EVERY * both
    needed = clearance + allowance
    rows_first, rows_second = _within_reach(first.coarse_bodies, second.coarse_bodies, needed + STRIDE * both)
    if not (rows_first.any() and rows_second.any()):
        return np.inf, allowance
    gap = _first_gap_below(
        first.placed(*first.around(np.any(rows_first, axis=1), EVERY)),
        second.placed(*second.around(np.any(rows_second, axis=1), EVERY)),
        needed,
    )
    return gap, allowance


def stay_apart(first: Paths, second: Paths, clearance: float) -> tuple[Numbers, str]:
    """Return the indices of the pairs of n paths on which two arms keep the clearance, at any relative speed, and why
    the first of the others is refused."""
    needed = clearance + (EVERY + STRIDE) * (first.deviation + second.deviation)
    near, refusal = _may_meet(first.coarse_bodies, first.coarse[0], second.coarse_bodies, second.coarse[0], needed), ""
    for row in np.flatnonzero(near).tolist():
        one = np.array([row])
        gap, allowance = gap_on_paths(first.take(one), second.take(one), clearance)
        near[row] = not gap >= clearance + allowance
        if near[row]:
            refusal = refusal or _too_near("come", gap, allowance, clearance, "each other")
    return np.flatnonzero(~near), refusal


def _may_meet(first: Placed, of_first: Numbers, second: Placed, of_second: Numbers, within: Array) -> Bools:
    """Return whether two arms, along the line between their bases, come within (n,) [m] on each of n paths, (n,).

    ``of_first`` and ``of_second`` are the paths, in order, to which the bodies of each arm belong. NaN counts as near.
    """
    along = _between_bases(first, second)
    farthest = [
        np.maximum.reduceat(_reach(placed, way).max(axis=1), np.flatnonzero(np.diff(path, prepend=-1)))
        for placed, way, path in ((first, along, of_first), (second, -along, of_second))
        if len(path)
    ]
    return ~(sum(farthest, np.zeros(len(within))) <= -within)


def _between_bases(first: Placed, second: Placed) -> Array:
    """Return the direction from the base of the first arm to that of the second, shape (3,)."""
    along = second.start[0, 0] - first.start[0, 0] if len(first.smr) else np.zeros(3)
    return np.asarray(along / max(float(np.linalg.norm(along)), 1e-12))


def _reach(placed: Placed, along: Array) -> Array:
    """Compute how far bodies reach from the origin along a direction (3,), shape (n, m) [m]."""
    return np.asarray(np.maximum(placed.start @ along, placed.end @ along) + placed.radius)


def _within_reach(first: Placed, second: Placed, clearance: float) -> tuple[np.ndarray, np.ndarray]:
    """Mask the bodies of each arm that reach past the other's nearest one, (n, m) bool each: only these can meet it.

    The extent is along the line between the bases. A NaN counts as within reach.
    """
    along = _between_bases(first, second)
    reach_first, reach_second = _reach(first, along), _reach(second, -along)
    return (~(reach_first + reach_second.max() <= -clearance), ~(reach_second + reach_first.max() <= -clearance))


def _first_gap_below(first: Placed, second: Placed, clearance: float) -> float:
    """Return the smallest distance [m] in the first batch that violates the clearance; infinite if none does."""
    near_first, near_second = _within_reach(first, second, clearance)
    i, a = np.nonzero(near_first)
    k, b = np.nonzero(near_second)
    if len(i) == 0:  # then none of the other's is near, either
        return np.inf
    ends, others = first.axes(i, a), second.axes(k, b)
    first_middle, second_middle = 0.5 * (ends[0] + ends[1]), 0.5 * (others[0] + others[1])
    first_square, second_square = np.sum(first_middle**2, axis=0), np.sum(second_middle**2, axis=0)
    extent, other_extent = first.arm.extents[a] + clearance + _ROUNDING_M, second.arm.extents[b]
    block = max(1, _PAIRS_AT_ONCE // len(k))
    for start in range(0, len(i), block):
        part = slice(start, start + block)
        squares = first_square[part, None] + second_square - 2.0 * (first_middle[:, part].T @ second_middle)
        near = ~(squares > (extent[part, None] + other_extent) ** 2)  # by spheres; also for NaN
        one, other = np.nonzero(near)
        if not len(one):
            continue
        one += start
        gap = segment_distance(*(end[:, one].T for end in ends), *(end[:, other].T for end in others))
        smallest = float((gap - first.radius[a[one]] - second.radius[b[other]]).min())
        if not smallest >= clearance:  # also for NaN
            return smallest
    return np.inf


BEAM_RADIUS = 0.02
"""Radius around the tracker's beam that no body may enter [m]: half the diameter of a 1.5 inch SMR."""
_SELF_CLEARANCE = 0.01
"""Clearance of an arm from itself [m]; smaller than from others, as its shape is known better than its base."""
_OWN_BASE_CLEARANCE = 0.02
"""Clearance of an arm from obstacles fixed to its own base [m]; smaller than from others, as the pose of the base,
known to centimetres before calibration, does not matter. It allows for a pose that was measured with a tape."""
_STEPS = (0.02, 0.04)
"""Smallest and largest spacing of samples on a path [m]; between these it is half the clearance."""
_ROUNDING_RAD = 1e-9
"""Tolerance of joint limits for rounding."""


@dataclass(frozen=True)
class CellBodies:
    """The bodies in the cell and the limits that hold for them.

    Attributes
    ----------
    arms : mapping
        Name -> ArmBodies.
    field : TrackerField or None
        None if the cell has no tracker.
    clearance : float
        Least distance between arms, and of arms from floor, ceiling and obstacles [m].
    floor, ceiling : float
        Heights of floor and ceiling in the cell frame C [m]; the ceiling may be infinite.
    obstacles : tuple of ObstacleBody
        What stands in the cell, poses in the cell frame C. Those mounted on a flange are with its arm.
    apart : float
        Additional distance that arms keep from each other while they move [m], as their positions may deviate.
    """

    arms: Mapping[str, ArmBodies]
    field: TrackerField | None
    clearance: float
    floor: float
    ceiling: float = math.inf
    obstacles: tuple[ObstacleBody, ...] = ()
    apart: float = 0.0

    @property
    def self_clearance(self) -> float:
        """Least distance of an arm from itself [m]."""
        return min(self.clearance, _SELF_CLEARANCE)

    @cached_property
    def obstacle_clearances(self) -> Mapping[ArmBodies, Array]:
        """Least distance that each body of an arm keeps from each obstacle, (k, m) [m]; -inf where they may touch.

        Base bodies stand on something by design. The first link only turns about the base's axis: it is checked only
        against obstacles from which the base bodies keep the clearance.
        """
        return {arm: self._clearances_of(name, arm) for name, arm in self.arms.items()}

    def _clearances_of(self, name: str, arm: ArmBodies) -> Array:
        asked = np.full((len(self.obstacles), len(arm.radius)), self.clearance)
        bodies = place(arm, np.zeros((1, arm.geometry.joints)))
        base = np.flatnonzero(arm.frames == 0)
        origin = arm.geometry.T_M_B()[:3, 3]
        start, end = (np.vstack([ends[0, base], origin]) for ends in (bodies.start, bodies.end))
        radius = np.append(arm.radius[base], 0.0)
        for row, obstacle in zip(asked, self.obstacles, strict=True):
            if obstacle.base_of == name:
                row[:] = min(self.clearance, _OWN_BASE_CLEARANCE)
            row[base] = -np.inf
            if not obstacle.gaps(start, end, radius, self.clearance).min() >= self.clearance:
                row[arm.frames == 1] = -np.inf
        return asked


Gate = Callable[[CellBodies, Mapping[str, Array], Mapping[str, Array]], str]
"""``refuse_motion``, or a function in its place."""


def refuse_stop(cell: CellBodies, q: Mapping[str, Array]) -> str:
    """Return why the arms must not stand at ``q`` (arm -> (N,) [rad]); empty if they may."""
    return refuse_motion(cell, q, q)


def refuse_motion(cell: CellBodies, q_from: Mapping[str, Array], q_to: Mapping[str, Array]) -> str:
    """Return why the arms must not move from ``q_from`` to ``q_to`` (arm -> (N,) [rad]); empty if they may.

    Requires finite numbers, a target inside the joint limits, and on the whole path the clearance of every arm from
    floor, ceiling, obstacles, the other arms and itself. The path is sampled; the largest distance of any point of a
    body from its nearest sample is added to the clearance, so that sampling never hides a collision.
    """
    unknown = [name for name in (*q_from, *q_to) if name not in cell.arms]
    if unknown:
        return f"arm {unknown[0]}: not in the cell; arms are {', '.join(cell.arms)}"
    missing = [name for name in cell.arms if name not in q_from or name not in q_to]
    if missing:
        return f"arm {missing[0]}: its position or target is not given"
    starts, targets = (
        {name: np.asarray(q[name], dtype=np.float64)[None] for name in cell.arms} for q in (q_from, q_to)
    )
    accepted, refusal = checked_motions(cell, starts, targets)
    return "" if len(accepted) else refusal or "it was not accepted"  # nothing moves because a reason is missing


def checked_motions(cell: CellBodies, q_from: Mapping[str, Array], q_to: Mapping[str, Array]) -> tuple[Numbers, str]:
    """Return the indices of those of n motions, arm -> (n, N) [rad], that are accepted, and why the first of the others
    is refused. The motions are of all arms of the cell."""
    rows, paths, first = np.arange(len(next(iter(q_to.values())))), dict[str, Paths](), ""

    def keep(kept: Numbers, refusal: str) -> None:
        nonlocal rows, paths, first
        rows, paths = rows[kept], {name: own.take(kept) for name, own in paths.items()}
        first = first or refusal

    for name, arm in cell.arms.items():
        possible, refusal = _values_possible(arm, q_from[name][rows], q_to[name][rows])
        keep(possible, f"arm {name}: {refusal}" if refusal else "")
        if not len(rows):
            return rows, first
        own = Paths.of(arm, q_from[name][rows], q_to[name][rows], sample_spacing(cell))
        free, refusal = alone_free(cell, own)
        keep(free, f"arm {name}: {refusal}" if refusal else "")
        paths[name] = own.take(free)
    asked = cell.clearance + cell.apart
    for one, other in combinations(cell.arms, 2):
        apart, refusal = stay_apart(paths[one], paths[other], asked)
        keep(apart, f"arms {one} and {other}: {refusal}" if refusal else "")
    return rows, first


def sample_spacing(cell: CellBodies) -> float:
    """Return the farthest that a point of a body moves between samples of two arms' paths [m].

    Between samples two arms may be nearer by at most this, other bodies by at most a quarter of it: a stop that keeps
    the clearance and this margin can be reached.
    """
    return min(max(0.5 * cell.clearance, _STEPS[0]), _STEPS[1])


def with_margin_for_ways(cell: CellBodies, *, between_arms: bool = False) -> CellBodies:
    """Enlarge the clearance so that the gate accepts motions to stops that keep it, of one arm or ``between_arms``."""
    return replace(cell, clearance=cell.clearance + (1.0 if between_arms else 0.25) * sample_spacing(cell))


def clear_alone(cell: CellBodies, placed: Placed) -> np.ndarray:
    """Return whether an arm is clear of floor, ceiling, obstacles and itself, ignoring other arms, (n,) bool."""
    clear = height_clearance(placed, cell.floor, cell.ceiling) >= cell.clearance
    rows = np.flatnonzero(clear)
    clear[rows] = self_clearance(placed.take(rows), cell.self_clearance) >= cell.self_clearance
    for obstacle, asked in zip(cell.obstacles, cell.obstacle_clearances[placed.arm], strict=True):
        rows, bodies = np.flatnonzero(clear), asked > -np.inf
        if not (len(rows) and bodies.any()):
            continue
        start, end = (ends[np.ix_(rows, bodies)] for ends in (placed.start, placed.end))
        gaps = obstacle.gaps(start, end, placed.radius[bodies], asked[bodies])
        clear[rows] = np.all(gaps >= asked[bodies], axis=1)
    return np.asarray(clear)


def clear_stops(cell: CellBodies, q: Mapping[str, Array]) -> np.ndarray:
    """Return whether ``refuse_stop`` is empty for each of n stops of all arms, arm -> (n, N) [rad], shape (n,) bool.

    Raises
    ------
    ValueError
        If the arms are not those of the cell.
    """
    if set(q) != set(cell.arms):
        raise ValueError(f"positions of {', '.join(q)} for the arms {', '.join(cell.arms)}")
    clear = np.ones(len(next(iter(q.values()))), dtype=bool)
    placed = {}
    for name, arm in cell.arms.items():
        placed[name] = place(arm, q[name])
        clear &= within_limits(arm, q[name]) & clear_alone(cell, placed[name])
    for first, second in combinations(placed, 2):
        rows = np.flatnonzero(clear)
        gap = gap_at_rest(placed[first].take(rows), placed[second].take(rows), cell.clearance)
        clear[rows] = gap >= cell.clearance
    return clear


def clear_pairs(cell: CellBodies, first: tuple[str, Array], second: tuple[str, Array]) -> np.ndarray:
    """Return whether two arms are clear and visible at each pair of configurations, (m, p) bool.

    The result is that of ``clear_stops`` and ``visible_stops`` for all pairs, but each arm alone is checked only once.
    ``first`` and ``second`` are the name of an arm and its configurations (m, N) and (p, N) [rad].
    """
    placed = [place(cell.arms[name], q) for name, q in (first, second)]
    alone = [
        within_limits(cell.arms[name], q) & clear_alone(cell, bodies) & visible(cell, name, q)
        for (name, q), bodies in zip((first, second), placed, strict=True)
    ]
    allowed = alone[0][:, None] & alone[1]
    i, k = np.nonzero(allowed)
    if len(i) and cell.field is not None:
        one, other = placed[0].take(i), placed[1].take(k)
        tracker = cell.field.T_C_M[:3, 3]
        free = gap_at_rest(one, other, cell.clearance) >= cell.clearance
        for target, bodies in ((one.smr, other), (other.smr, one)):
            rows = np.flatnonzero(free)
            free[rows] = beam_clearance(tracker, target[rows], bodies.take(rows), own=False) > BEAM_RADIUS
        allowed[i, k] = free
    return np.asarray(allowed)


def within_limits(arm: ArmBodies, q: Array) -> np.ndarray:
    """Return whether ``q`` (n, N) [rad] is within the joint limits of an arm with bodies, (n,) bool; False for NaN."""
    low, high = arm.limits.T
    return np.asarray(np.all((q >= low - _ROUNDING_RAD) & (q <= high + _ROUNDING_RAD), axis=1) & (arm.links > 0))


def visible(cell: CellBodies, name: str, q: Array, others: Mapping[str, Array] | None = None) -> np.ndarray:
    """Return whether the tracker can see the SMR of an arm at ``q`` (n, N) [rad], shape (n,) bool.

    The SMR must be in the tracker's field of view, the beam within the SMR's acceptance angle, and no obstacle and no
    body of the arm or of ``others`` (arm -> (n, N) [rad]) in the beam. Without a tracker nothing is visible.
    """
    if cell.field is None:
        return np.zeros(len(q), dtype=bool)
    bodies = place(cell.arms[name], q)
    tracker = cell.field.T_C_M[:3, 3]
    seen = in_view(cell.field, bodies)
    rows = np.flatnonzero(seen)
    if len(rows):
        bodies = bodies.take(rows)
        free = beam_clearance(tracker, bodies.smr, bodies, own=True) > BEAM_RADIUS
        free &= ~mounted_hides(tracker, bodies, BEAM_RADIUS)
        free &= beam_gaps(cell.obstacles, tracker, bodies.smr, BEAM_RADIUS) > BEAM_RADIUS
        for other, other_q in (others or {}).items():
            other_bodies = place(cell.arms[other], other_q[rows])
            free &= beam_clearance(tracker, bodies.smr, other_bodies, own=False) > BEAM_RADIUS
        seen[rows] = free
    return seen


def visible_stops(cell: CellBodies, q: Mapping[str, Array]) -> np.ndarray:
    """Return whether the tracker sees the SMRs of all arms at each of n stops, arm -> (n, N) [rad], shape (n,) bool."""
    seen = np.ones(len(next(iter(q.values()))), dtype=bool)
    for name in q:
        rows = np.flatnonzero(seen)
        others = {other: value[rows] for other, value in q.items() if other != name}
        seen[rows] = visible(cell, name, q[name][rows], others)
    return seen


def in_view(field: TrackerField, bodies: Placed) -> np.ndarray:
    """Return whether SMRs are in the field of view and the beam within their acceptance angle, shape (n,) bool."""
    conditions = sight_conditions(field, bodies.arm.acceptance, sight_of(field.T_C_M, bodies))
    return np.asarray(np.logical_and.reduce([holds for _, holds in conditions]))


def predicted_smr(cell: CellBodies, name: str, q: Array) -> Array:
    """Compute the expected SMR positions of an arm at ``q`` (n, N) [rad], shape (n, 3) in the tracker frame [m].

    Raises ``ValueError`` if the cell has no tracker.
    """
    if cell.field is None:
        raise ValueError("the cell has no tracker")
    T_C_M = cell.field.T_C_M
    return np.asarray((smr_positions(cell.arms[name].geometry, q) - T_C_M[:3, 3]) @ T_C_M[:3, :3])


def _values_possible(arm: ArmBodies, start: Array, target: Array) -> tuple[Numbers, str]:
    """Return the indices of the motions between joint vectors (n, N) that an arm may make, and why the first of the
    others is refused; only targets must be inside the limits."""
    joints, none = arm.geometry.joints, np.arange(0)
    if arm.links == 0:
        return none, "has no bodies, so that collisions cannot be checked; add capsules to its type"
    for q in (start, target):
        if q.shape[1:] != (joints,):
            return none, f"{q[:1].size} joint positions for {joints} joints"
    finite = np.asarray(np.isfinite(np.hstack([start, target])).all(axis=1))
    possible = finite & within_limits(arm, target)
    if possible.all():
        return np.arange(len(target)), ""
    row = int(np.argmin(possible))
    if not finite[row]:
        return np.flatnonzero(possible), "a joint position is not a finite number"
    outside = np.maximum(arm.limits[:, 0] - target[row], target[row] - arm.limits[:, 1]) > _ROUNDING_RAD
    j = int(np.argmax(outside))
    (low, high), q_j = np.degrees(arm.limits[j]), math.degrees(target[row, j])
    words = f"joint {j + 1} at {q_j:.1f} deg is outside its limits {low:.1f} to {high:.1f} deg"
    return np.flatnonzero(possible), words


def alone_free(cell: CellBodies, paths: Paths) -> tuple[Numbers, str]:
    """Return the indices of the paths on which an arm is clear of floor, ceiling, obstacles and itself, without regard
    to other arms, and why the first of the others is refused.

    The comparisons are negated so that a NaN refuses.
    """
    free, first = np.arange(len(paths.count)), ""
    obstacles = (_obstacles_free,) if cell.obstacles else ()
    for condition in (_heights_free, *obstacles, _itself_free):
        if len(free):
            kept, refusal = condition(cell, paths.take(free))
            free, first = free[kept], first or refusal
    return free, first


def _heights_free(cell: CellBodies, paths: Paths) -> tuple[Bools, str]:
    needed, bodies = cell.clearance + paths.deviation, paths.coarse_bodies
    heights = height_clearance(bodies, cell.floor, cell.ceiling)
    path, sample = paths.around(~(heights >= (needed + STRIDE * paths.deviation)[paths.coarse[0]]))
    free, refusal = np.ones(len(needed), dtype=np.bool_), ""
    if len(path):
        bodies = paths.placed(path, sample)
        for gaps, what in (
            (height_clearance(bodies, floor=cell.floor), "the floor"),
            (height_clearance(bodies, ceiling=cell.ceiling), "the ceiling"),
        ):
            low = path[~(gaps >= needed[path])]
            free[low] = False
            if len(low) and not refusal:
                gap, hidden = float(gaps[path == low[0]].min()), float(paths.deviation[low[0]])
                refusal = _too_near("comes", gap, hidden, cell.clearance, what)
    return free, refusal


def _obstacles_free(cell: CellBodies, paths: Paths) -> tuple[Bools, str]:
    clearances, bodies = cell.obstacle_clearances[paths.arm], paths.coarse_bodies
    deviations = paths.half_step @ paths.arm.body_levers.T
    spread = ((STRIDE + 1) * deviations)[paths.coarse[0]]  # from any point of a path to the nearest coarse sample
    unclear, near = np.zeros(len(bodies.smr), dtype=np.bool_), []
    for obstacle, asked in zip(cell.obstacles, clearances, strict=True):
        gaps = obstacle.gaps(bodies.start, bodies.end, bodies.radius, asked + spread)
        rows = np.any(~(gaps >= asked + spread), axis=1)
        if rows.any():
            unclear |= rows
            near.append((obstacle, asked))
    path, sample = paths.around(unclear)
    bodies, free, refusal = paths.placed(path, sample), np.ones(len(paths.count), dtype=np.bool_), ""
    refused = len(free)
    for obstacle, asked in near:
        needed = (asked + deviations)[path]
        gaps = obstacle.gaps(bodies.start, bodies.end, bodies.radius, needed)
        low = path[np.any(~(gaps >= needed), axis=1)]
        free[low] = False
        if len(low) and low[0] < refused:
            refused, its = int(low[0]), path == low[0]
            k = int(np.argmin(np.min((gaps - needed)[its], axis=0)))
            gap, hidden = float(gaps[its, k].min()), float(deviations[refused, k])
            words = _too_near("comes", gap, hidden, float(asked[k]), f"obstacle '{obstacle.name}'")
            refusal = _carried(paths.arm, k) + words
    return free, refusal


def _itself_free(cell: CellBodies, paths: Paths) -> tuple[Bools, str]:
    i, k = paths.arm.own_pairs
    free = np.ones(len(paths.count), dtype=np.bool_)
    if not len(i):
        return free, ""
    needed = np.maximum(cell.self_clearance, paths.deviation)
    # seen from one body of a pair, the other is moved only by the joints between them
    spread = paths.half_step @ paths.arm.pair_levers.T * STRIDE  # (n, p)
    enough = (needed[:, None] + spread)[paths.coarse[0]]
    unclear = ~(pair_gaps(paths.coarse_bodies, i, k, enough) >= enough)
    path, sample = paths.around(np.any(unclear, axis=1))
    if not len(path):
        return free, ""
    asked, pairs = needed[path, None], np.any(unclear, axis=0)
    gaps = pair_gaps(paths.placed(path, sample), i[pairs], k[pairs], asked)
    low = path[~np.all(gaps >= asked, axis=1)]
    free[low] = False
    if not len(low):
        return free, ""
    of_pairs = gaps[path == low[0]].min(axis=0)
    worst = int(np.argmin(of_pairs))
    carried = _carried(paths.arm, max(int(i[pairs][worst]), int(k[pairs][worst])))
    what = "the arm itself" if carried else "itself"
    hidden = float(paths.deviation[low[0]])
    return free, carried + _too_near("comes", float(of_pairs[worst]), hidden, cell.self_clearance, what)


def _carried(arm: ArmBodies, body: int) -> str:
    """Name the mounted obstacle that a body covers, as the subject of a refusal; empty for the arm's own bodies."""
    return "" if body < arm.links else f"its '{arm.covered[body - arm.links]}' "


def _too_near(verb: str, gap: float, allowance: float, asked: float, what: str) -> str:
    """Say by how much a clearance [m] is missed; ``gap`` was found at a sample, which may hide ``allowance``."""
    if math.isnan(gap):
        return f"the distance from {what} is not a number"
    if gap < 0.0:
        return f"{'collide with' if verb == 'come' else 'collides with'} {what}"
    if gap >= asked:
        verb, gap = f"may {verb.removesuffix('s')}", max(gap - allowance, 0.0)
    return f"{verb} within {math.floor(gap * 1e3)} mm of {what}, {asked * 1e3:.0f} mm asked"


# -- The gate for paths that one arm follows, or several simultaneously, while the others rest ------------------------


_CHORD_RAD = 0.05
"""Largest joint motion between two samples that the gate checks as one straight motion in joint space."""


def refuse_path(cell: CellBodies, name: str, q: Array, others: Mapping[str, Array], s: Array) -> str:
    """Return why arm ``name`` must not follow ``q`` (m, N) [rad] while the ``others`` rest; empty if it may.

    As ``refuse_paths``; ``s`` (m,) are arc lengths [m], for the message.
    """
    row, refusal = refuse_paths(cell, {name: q}, others)
    return f"at {s[row] * 1e3:.0f} mm: {refusal}" if refusal else ""


def refuse_paths(
    cell: CellBodies,
    paths: Mapping[str, Array],
    others: Mapping[str, Array],
    gate: Gate = refuse_motion,
    apart_m: float = 0.0,
) -> tuple[int, str]:
    """Return the first row at which arms must not follow ``paths``, arm -> (m, N) [rad], all at the same row at the
    same time while the ``others`` rest, and why; an empty reason if they may.

    The gate checks straight motions in joint space between samples of the paths, each arm at any relative speed; the
    deviation of the paths from these motions is added to the clearance. ``apart_m`` is added to the distance between
    arms: so far they may deviate from all being at one row [m].
    """
    if not all(np.isfinite(q).all() for q in paths.values()):
        return 0, "a joint position of the path is not a finite number"
    steps = [np.abs(np.diff(q, axis=0)).max(axis=1) for q in paths.values()]
    travelled = np.concatenate([[0.0], np.cumsum(np.max(steps, axis=0))])
    rows = np.searchsorted(travelled, np.arange(0.0, travelled[-1] + _CHORD_RAD, _CHORD_RAD))
    rows = np.unique(np.append(rows[rows < len(travelled)], len(travelled) - 1))
    beside = sum(float(_beside_chords(q, rows, travelled) @ cell.arms[name].levers) for name, q in paths.items())
    wider = replace(cell, clearance=cell.clearance + beside, apart=cell.apart + apart_m)
    for first, last in pairwise(rows.tolist()):
        ends = ({**others, **{name: q[row] for name, q in paths.items()}} for row in (first, last))
        refusal = gate(wider, *ends)
        if refusal:
            return first, refusal
    return 0, ""


def _beside_chords(q: Array, rows: np.ndarray, travelled: Array) -> Array:
    """Compute each joint's largest deviation (N,) [rad] from straight motions between ``rows`` of ``q`` (m, N)."""
    chords = rows_at(travelled, travelled[rows], q[rows])
    return np.asarray(np.abs(q - chords).max(axis=0))


# -- Paths that arms follow simultaneously, and how far the arms are from being at the same row of them ---------------
#
# Each controller has its own clock: one arm may start a little later than another, or fall behind. The gate accepts
# paths of several arms with a margin (``allowed_apart_m``). While they move, the deviation from the same row is
# computed from their joints (``apart_m``); more than ``MOST_APART_M`` is a fault, which stops all arms.


MOST_APART_M = 0.05
"""Deviation of the arms from the same row at which all of them are stopped [m]."""
LOOK_S = 0.1
"""Longest wait for one arm before the states of all are read."""
_REACTION_S = 0.5
"""Time to detect the deviation and to brake the arms: two waits, an old state, the braking itself."""


def allowed_apart_m(cell: CellBodies, paths: Mapping[str, Array], period_s: float) -> float:
    """Compute how far the arms of ``paths``, arm -> (m, N) [rad], one row each ``period_s`` [s], may deviate from all
    being at one row [m]; 0 for one arm.

    If one of two arms is late, either may be taken as the one off its place; so the slower one counts.
    """
    if len(paths) < 2:
        return 0.0
    steps_m = [float((np.abs(np.diff(q, axis=0)) @ cell.arms[name].levers).max()) for name, q in paths.items()]
    return MOST_APART_M + _REACTION_S * sorted(steps_m)[-2] / period_s


def apart_m(cell: CellBodies, paths: Mapping[str, Array], q: Mapping[str, Array]) -> float:
    """Compute how far arms at ``q`` (arm -> (N,) [rad]) are at most from all being at one row of ``paths`` [m]."""
    off = [np.abs(path - q[name]) @ cell.arms[name].levers for name, path in paths.items()]
    return float(np.sum(off, axis=0).min())


def on_rows(q: Array, period_s: float, wanted_s: float) -> Array:
    """Resample a path ``q`` (m, N) from a row each ``period_s`` [s] to a row each ``wanted_s`` [s]."""
    if period_s == wanted_s:
        return q
    time_s = np.arange(len(q)) * period_s
    times = np.arange(int(np.ceil(time_s[-1] / wanted_s)) + 1) * wanted_s
    return rows_at(times, time_s, q)


def equally_long(paths: Mapping[str, Array]) -> dict[str, Array]:
    """Extend the paths (m, N) of arms that end earlier: these rest at their ends."""
    rows = max(map(len, paths.values()))
    return {name: np.concatenate([q, np.repeat(q[-1:], rows - len(q), axis=0)]) for name, q in paths.items()}


_AT_ONCE = 100
"""Number of motions in a batch: their samples fit in the cache."""

Configuration = Mapping[str, Array]
"""Arm -> joint positions (N,) [rad]."""


class FreeMotions:
    """Cache of what the gate answers about motions in one cell; motions known in advance are checked in batches."""

    def __init__(self, cell: CellBodies) -> None:
        self._cell = cell
        self._known: dict[bytes, bool] = {}

    def ask(self, motions: Iterable[tuple[Configuration, Configuration]]) -> None:
        """Check motions that are likely to be needed, and cache the answers."""
        new = {key: motion for motion in motions if (key := self._key(*motion)) not in self._known}
        if new:
            q_from, q_to = (
                {name: np.array([q[name] for q in ends]) for name in self._cell.arms}
                for ends in zip(*new.values(), strict=True)
            )
            self._known.update(zip(new, free_motions(self._cell, q_from, q_to).tolist(), strict=True))

    def free(self, here: Configuration, there: Configuration) -> bool:
        """Return whether the gate accepts a motion of all arms."""
        key = self._key(here, there)
        if key not in self._known:
            self._known[key] = not refuse_motion(self._cell, here, there)
        return self._known[key]

    def _key(self, here: Configuration, there: Configuration) -> bytes:
        return b"".join(q[name].tobytes() for name in self._cell.arms for q in (here, there))


def free_motions(cell: CellBodies, q_from: Mapping[str, Array], q_to: Mapping[str, Array]) -> Bools:
    """Return whether ``refuse_motion`` is empty for each of n motions of all arms, arm -> (n, N) [rad], shape (n,).

    Raises
    ------
    ValueError
        If the arms are not those of the cell.
    """
    if set(q_from) != set(cell.arms) or set(q_to) != set(cell.arms):
        raise ValueError(f"motions of {', '.join({*q_from, *q_to})} for the arms {', '.join(cell.arms)}")
    free = np.zeros(len(next(iter(q_to.values()))), dtype=np.bool_)
    for first in range(0, len(free), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        accepted, _ = checked_motions(cell, *({name: q[part] for name, q in ends.items()} for ends in (q_from, q_to)))
        free[first + accepted] = True
    return free
