"""The safety gate: conditions for every motion, used by planning, collection, compensation and the doctor.

A motion is a straight line in joint space. Two arms may run at any relative speed: every point of one arm's path is
checked against every point of the other's. The gate fails closed: whatever it cannot check, it refuses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from cellapp.kinematics.chain import smr_positions
from cellapp.kinematics.transforms import Array
from cellapp.safety.bodies import (
    ArmBodies,
    Placed,
    beam_clearance,
    ceiling_clearance,
    floor_clearance,
    pair_gaps,
    place,
    segment_distance,
    self_clearance,
)

_BEAM_RADIUS = 0.02
"""Radius around the tracker's beam that no body may enter [m]: half the diameter of a 1.5 inch SMR."""
_SELF_CLEARANCE = 0.01
"""Clearance of an arm from itself [m]; smaller than from others, as its shape is known better than its base."""
_ACCEPTANCE_MARGIN = math.radians(3.0)
"""Subtracted from the SMR's acceptance angle: base and flange are not known exactly before calibration."""
_STEPS = (0.02, 0.04)
"""Smallest and largest spacing of samples on a path [m]; between them it is half the clearance."""
_EVERY = 2
"""Stride of the samples that are checked against other arms, where all pairs of samples are compared. Floor and self
checks use all samples. The coarser spacing is added to the clearance."""
_STRIDE = 8
"""Stride of the samples that are looked at first, a multiple of 2 * ``_EVERY``."""
_PAIRS_AT_ONCE = 20_000
"""Pairs of capsules per batch: some MB of memory, and an early end at the first collision."""
_ROUNDING_RAD = 1e-9
"""Joint positions may exceed a limit by rounding."""


@dataclass(frozen=True)
class TrackerField:
    """Field of view of the tracker at pose ``T_C_M`` (4, 4) in the cell frame C: ranges in the tracker frame.

    ``azimuth`` and ``elevation`` in [rad], the azimuth range may cross the cut at pi; ``distance`` in [m].
    """

    T_C_M: Array
    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    distance: tuple[float, float]


@dataclass(frozen=True)
class CellBodies:
    """The bodies in the cell and the limits that hold for them.

    Attributes
    ----------
    arms : mapping
        Name -> ArmBodies.
    field : TrackerField or None
    clearance : float
        Least distance between arms, and of arms from floor and ceiling [m].
    floor, ceiling : float
        Heights of floor and ceiling in the cell frame C [m]; the ceiling may be infinite.
    """

    arms: Mapping[str, ArmBodies]
    field: TrackerField | None
    clearance: float
    floor: float
    ceiling: float = math.inf


Gate = Callable[[CellBodies, Mapping[str, Array], Mapping[str, Array]], str]
"""``refuse_motion``, or what stands for it."""


def refuse_stop(cell: CellBodies, q: Mapping[str, Array]) -> str:
    """Reason why the arms must not stand at ``q`` (arm -> (N,) [rad]); empty if they may."""
    return refuse_motion(cell, q, q)


def refuse_motion(cell: CellBodies, q_from: Mapping[str, Array], q_to: Mapping[str, Array]) -> str:
    """Reason why the arms must not move from ``q_from`` to ``q_to`` (arm -> (N,) [rad]); empty if they may.

    Requires finite numbers, a target inside the joint limits, and on the whole path the clearance of every arm from
    floor, ceiling, the other arms and itself. The path is sampled; the farthest that any point of a body can be from
    its nearest sample is added to the clearance, so that sampling never hides a collision.
    """
    unknown = [name for name in (*q_from, *q_to) if name not in cell.arms]
    if unknown:
        return f"arm {unknown[0]}: not in the cell; arms are {', '.join(cell.arms)}"
    missing = [name for name in cell.arms if name not in q_from or name not in q_to]
    if missing:
        return f"arm {missing[0]}: its position or target is not given"
    paths: dict[str, _Path] = {}
    for name, arm in cell.arms.items():
        start, target = np.asarray(q_from[name], dtype=np.float64), np.asarray(q_to[name], dtype=np.float64)
        refusal = _refuse_values(arm, start, target)
        if not refusal:
            paths[name] = _sample_path(arm, start, target, min(max(0.5 * cell.clearance, _STEPS[0]), _STEPS[1]))
            refusal = _refuse_alone(cell, paths[name])
        if refusal:
            return f"arm {name}: {refusal}"
    for first, second in combinations(paths, 2):
        if not _keep_apart(paths[first], paths[second], cell.clearance):
            return f"arms {first} and {second}: come nearer than {cell.clearance * 1e3:.0f} mm"
    return ""


def clear_alone(cell: CellBodies, placed: Placed) -> np.ndarray:
    """Whether an arm is clear of floor, ceiling and itself, without regard to other arms, shape (n,) bool."""
    heights = np.minimum(floor_clearance(placed, cell.floor), ceiling_clearance(placed, cell.ceiling))
    return np.asarray((heights > cell.clearance) & (self_clearance(placed) > _SELF_CLEARANCE))


def visible(cell: CellBodies, name: str, q: Array, others: Mapping[str, Array] | None = None) -> np.ndarray:
    """Whether the tracker can see the SMR of an arm at ``q`` (n, N) [rad], shape (n,) bool.

    The SMR must be in the tracker's field of view, the beam within the SMR's acceptance angle, and no body of the arm
    or of ``others`` (arm -> (n, N) [rad]) in the beam. Without a tracker nothing is visible.
    """
    if cell.field is None:
        return np.zeros(len(q), dtype=bool)
    arm = cell.arms[name]
    bodies = place(arm, q)
    T_C_M = cell.field.T_C_M
    in_M = (bodies.smr - T_C_M[:3, 3]) @ T_C_M[:3, :3]
    distance = np.linalg.norm(in_M, axis=1)
    azimuth = np.arctan2(in_M[:, 1], in_M[:, 0])
    elevation = np.arcsin(np.clip(in_M[:, 2] / distance, -1.0, 1.0))
    seen = np.ones(len(q), dtype=bool)
    for value, (low, high) in ((elevation, cell.field.elevation), (distance, cell.field.distance)):
        seen &= (value >= low) & (value <= high)
    left, right = cell.field.azimuth
    seen &= np.mod(azimuth - left, 2.0 * math.pi) <= right - left
    back = (T_C_M[:3, 3] - bodies.smr) / distance[:, None]
    cosine = np.einsum("na,na->n", back, bodies.normal)
    seen &= cosine > math.cos(max(0.0, arm.acceptance - _ACCEPTANCE_MARGIN))
    rows = np.flatnonzero(seen)
    if len(rows):
        seen[rows] &= beam_clearance(T_C_M[:3, 3], bodies.smr[rows], bodies.take(rows), own=True) > _BEAM_RADIUS
        for other, other_q in (others or {}).items():
            other_bodies = place(cell.arms[other], other_q[rows])
            seen[rows] &= beam_clearance(T_C_M[:3, 3], bodies.smr[rows], other_bodies, own=False) > _BEAM_RADIUS
    return seen


def predicted_smr(cell: CellBodies, name: str, q: Array) -> Array:
    """Expected SMR positions of an arm at ``q`` (n, N) [rad], shape (n, 3) in the tracker frame [m].

    Raises ``ValueError`` if the cell has no tracker.
    """
    if cell.field is None:
        raise ValueError("the cell has no tracker")
    T_C_M = cell.field.T_C_M
    return np.asarray((smr_positions(cell.arms[name].geometry, q) - T_C_M[:3, 3]) @ T_C_M[:3, :3])


@dataclass(frozen=True, eq=False)
class _Path:
    """Evenly spaced samples of one arm's path; no point of a body is farther than ``deviation`` [m] from its nearest.

    Most of a path is far from everything. Every ``_STRIDE``-th sample is looked at first; the samples around it are
    placed only where a body, displaced as far as it can be there, could come too near.
    """

    arm: ArmBodies
    start: Array
    target: Array
    count: int
    deviation: float

    def placed(self, samples: np.ndarray) -> Placed:
        """The bodies at some of the samples."""
        share = np.linspace(0.0, 1.0, self.count)[samples]
        return place(self.arm, self.start + share[:, None] * (self.target - self.start))

    @property
    def spread(self) -> float:
        """Farthest that a point of a body at any sample is from where it is at the nearest coarse sample [m]."""
        return _STRIDE * self.deviation

    @cached_property
    def coarse(self) -> np.ndarray:
        """Every ``_STRIDE``-th sample and the last one."""
        return np.append(np.arange(0, self.count - 1, _STRIDE), self.count - 1)

    @cached_property
    def coarse_bodies(self) -> Placed:
        """The bodies at the coarse samples."""
        return self.placed(self.coarse)

    def around(self, doubtful: np.ndarray, every: int = 1) -> np.ndarray:
        """Of every ``every``-th sample, those nearest to the ``doubtful`` ones (bool) of the coarse samples."""
        near = self.coarse[doubtful][:, None] + np.arange(-(_STRIDE // 2), _STRIDE // 2 + 1)
        chosen = np.zeros(self.count, dtype=bool)
        chosen[np.clip(near, 0, self.count - 1)] = True
        return np.flatnonzero(chosen[::every]) * every


def _sample_path(arm: ArmBodies, start: Array, target: Array, spacing: float) -> _Path:
    """Sample a path so that no point of a body moves more than ``spacing`` [m] in ``_EVERY`` steps."""
    longest = float(np.abs(target - start) @ arm.levers)
    count = _EVERY * max(1, math.ceil(longest / spacing)) + 1
    return _Path(arm, start, target, count, 0.5 * longest / (count - 1))


def _refuse_values(arm: ArmBodies, start: Array, target: Array) -> str:
    """Reason why an arm must not move between two joint vectors; only the target must be inside the limits."""
    if len(arm.radius) == 0:
        return "has no bodies, so that collisions cannot be checked; add capsules to its type"
    joints = arm.geometry.joints
    for q in (start, target):
        if q.shape != (joints,):
            return f"{q.size} joint positions for {joints} joints"
        if not np.isfinite(q).all():
            return "a joint position is not a finite number"
    outside = (target < arm.limits[:, 0] - _ROUNDING_RAD) | (target > arm.limits[:, 1] + _ROUNDING_RAD)
    if not outside.any():
        return ""
    j = int(np.argmax(outside))
    low, high = np.degrees(arm.limits[j])
    return f"joint {j + 1} at {math.degrees(target[j]):.1f} deg is outside its limits {low:.1f} to {high:.1f} deg"


def _refuse_alone(cell: CellBodies, path: _Path) -> str:
    """Reason why one arm must not follow its path, without regard to other arms; empty if it may.

    The comparisons are negated so that a NaN refuses.
    """
    needed = cell.clearance + path.deviation
    bodies = path.coarse_bodies
    heights = np.minimum(floor_clearance(bodies, cell.floor), ceiling_clearance(bodies, cell.ceiling))
    doubtful = ~(heights >= needed + path.spread)
    if doubtful.any():
        bodies = path.placed(path.around(doubtful))
        if not floor_clearance(bodies, cell.floor).min() >= needed:
            return f"comes nearer to the floor than {cell.clearance * 1e3:.0f} mm"
        if not ceiling_clearance(bodies, cell.ceiling).min() >= needed:
            return f"comes nearer to the ceiling than {cell.clearance * 1e3:.0f} mm"
    if not _clear_of_itself(path, max(min(cell.clearance, _SELF_CLEARANCE), path.deviation)):
        return "comes too near to itself"
    return ""


def _clear_of_itself(path: _Path, needed: float) -> bool:
    """Whether an arm keeps ``needed`` [m] from itself at all samples of its path."""
    i, k = path.arm.own_pairs
    if len(i) == 0:
        return True
    # one body of a pair, as seen from the other, moves by the joints between them only
    spread = path.arm.pair_levers @ np.abs(path.target - path.start) * (0.5 * _STRIDE / (path.count - 1))
    doubtful = ~(pair_gaps(path.coarse_bodies, i, k) >= needed + spread)
    pairs = np.any(doubtful, axis=0)
    if not pairs.any():
        return True
    bodies = path.placed(path.around(np.any(doubtful, axis=1)))
    return bool(pair_gaps(bodies, i[pairs], k[pairs]).min() >= needed)


def _keep_apart(first: _Path, second: _Path, clearance: float) -> bool:
    """Whether two arms keep ``clearance`` [m] at any relative speed on their paths."""
    needed = clearance + _EVERY * (first.deviation + second.deviation)
    rows_first, rows_second = _within_reach(
        first.coarse_bodies, second.coarse_bodies, needed + first.spread + second.spread
    )
    if not (rows_first.any() and rows_second.any()):
        return True
    return _keeps_clearance(
        first.placed(first.around(np.any(rows_first, axis=1), _EVERY)),
        second.placed(second.around(np.any(rows_second, axis=1), _EVERY)),
        needed,
    )


def _within_reach(first: Placed, second: Placed, clearance: float) -> tuple[np.ndarray, np.ndarray]:
    """Bodies of each arm that reach past the other's nearest one, (n, m) bool each: only these can meet it.

    The extent is along the line between the bases. A NaN counts as within reach.
    """
    along = second.start[0, 0] - first.start[0, 0]
    along = along / max(float(np.linalg.norm(along)), 1e-12)
    reach_first = np.maximum(first.start @ along, first.end @ along) + first.radius
    reach_second = np.minimum(second.start @ along, second.end @ along) - second.radius
    return (
        ~(reach_first <= reach_second.min() - clearance),
        ~(reach_second >= reach_first.max() + clearance),
    )


def _keeps_clearance(first: Placed, second: Placed, clearance: float) -> bool:
    """Whether all samples of one arm keep the clearance [m] from all samples of the other."""
    near_first, near_second = _within_reach(first, second, clearance)
    i, a = np.nonzero(near_first)
    k, b = np.nonzero(near_second)
    if len(i) == 0 or len(k) == 0:
        return True
    first_radius, second_radius = first.radius[a], second.radius[b]
    block = max(1, _PAIRS_AT_ONCE // len(k))
    for start in range(0, len(i), block):
        rows, bodies = i[start : start + block], a[start : start + block]
        gap = segment_distance(
            first.start[rows, bodies][:, None],
            first.end[rows, bodies][:, None],
            second.start[k, b],
            second.end[k, b],
        )
        if not (gap - first_radius[start : start + block, None] - second_radius).min() >= clearance:  # also for NaN
            return False
    return True
