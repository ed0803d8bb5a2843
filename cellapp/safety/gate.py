"""The safety gate: what must hold before anything moves. Used by planning, collection and compensation alike.

A motion is a straight line in joint space. Two arms may run at any speed relative to one another: every place of one
on its way is checked against every place of the other on its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cellapp.kinematics.transforms import Array
from cellapp.safety.bodies import (
    ArmBodies,
    Placed,
    beam_clearance,
    between_arms,
    ceiling_clearance,
    floor_clearance,
    place,
    segment_distance,
    self_clearance,
)

_BEAM_RADIUS = 0.02
_SELF_CLEARANCE = 0.01
_STEPS = (0.02, 0.04)
"""Finest and coarsest sampling of a way [m]; between them it goes with the clearance."""
_EVERY = 2
"""Of the samples that are held against the arm itself and the floor, each so many-th is held against other arms: there
all pairs count."""
_PAIRS_AT_ONCE = 20_000


@dataclass(frozen=True)
class TrackerField:
    """What the tracker can see. ``T_C_M`` (4, 4) is its pose; ranges in [rad] and [m]."""

    T_C_M: Array
    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    distance: tuple[float, float]


@dataclass(frozen=True)
class CellBodies:
    """All that stands in the cell.

    Attributes
    ----------
    arms : mapping
        Name -> ArmBodies.
    field : TrackerField or None
    clearance : float
        Least distance of bodies from one another and from the floor [m].
    floor, ceiling : float
        Heights in C [m] that nothing may pass; the ceiling may be infinite.
    """

    arms: Mapping[str, ArmBodies]
    field: TrackerField | None
    clearance: float
    floor: float
    ceiling: float = math.inf


def refuse_stop(cell: CellBodies, q: Mapping[str, Array]) -> str:
    """Why the arms must not stand at ``q`` (name -> (N,)); empty if they may."""
    return refuse_motion(cell, q, q)


def refuse_motion(cell: CellBodies, q_from: Mapping[str, Array], q_to: Mapping[str, Array]) -> str:
    """Why the arms must not go from ``q_from`` to ``q_to`` (name -> (N,)); empty if they may.

    Checks that the numbers are numbers, the target is inside the joint limits, and on the way every arm keeps its
    clearance from the floor and from the other arms, and does not touch itself. The way is sampled; what may happen
    between two samples is added to the clearance, so that the answer never errs on the unsafe side.
    """
    unknown = [name for name in (*q_from, *q_to) if name not in cell.arms]
    if unknown:
        return f"arm {unknown[0]}: there is no such arm in the cell"
    missing = [name for name in cell.arms if name not in q_from or name not in q_to]
    if missing:
        return f"arm {missing[0]}: nobody says where it stands and where it shall go"
    placed: dict[str, Placed] = {}
    strays: dict[str, float] = {}
    for name, arm in cell.arms.items():
        if len(arm.radius) == 0:
            return f"arm {name}: has no bodies, so that no collision can be foreseen; add capsules to its type"
        here, there = np.asarray(q_from[name], dtype=np.float64), np.asarray(q_to[name], dtype=np.float64)
        joints = arm.geometry.joints
        for q in (here, there):
            if q.shape != (joints,):
                return f"arm {name}: {q.size} joint positions for {joints} joints"
            if not np.isfinite(q).all():
                return f"arm {name}: a joint position is not a finite number"
        outside = (there < arm.limits[:, 0] - 1e-9) | (there > arm.limits[:, 1] + 1e-9)
        if outside.any():
            j = int(np.argmax(outside))
            low, high = np.degrees(arm.limits[j])
            return (
                f"arm {name}: joint {j + 1} at {math.degrees(there[j]):.1f} deg is outside"
                f" its limits {low:.1f} to {high:.1f} deg"
            )
        samples, stray = _samples(arm, here, there, min(max(0.5 * cell.clearance, _STEPS[0]), _STEPS[1]))
        way = place(arm, samples)
        if not floor_clearance(way, cell.floor).min() >= cell.clearance + stray:
            return f"arm {name}: comes nearer to the floor than {cell.clearance * 1e3:.0f} mm"
        if not ceiling_clearance(way, cell.ceiling).min() >= cell.clearance + stray:
            return f"arm {name}: comes nearer to the ceiling than {cell.clearance * 1e3:.0f} mm"
        # an arm knows its own shape better than where it stands: nothing between two samples can make it touch itself
        if not self_clearance(way).min() >= max(min(cell.clearance, _SELF_CLEARANCE), stray):
            return f"arm {name}: comes too near to itself"
        placed[name], strays[name] = way.take(slice(None, None, _EVERY)), _EVERY * stray
    names = list(placed)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            if not _apart(placed[first], placed[second], cell.clearance + strays[first] + strays[second]):
                return f"arms {first} and {second}: come nearer than {cell.clearance * 1e3:.0f} mm"
    return ""


def clear_alone(cell: CellBodies, placed: Placed) -> np.ndarray:
    """Whether an arm is clear of floor, ceiling and itself, other arms left aside, shape (n,) bool."""
    heights = np.minimum(floor_clearance(placed, cell.floor), ceiling_clearance(placed, cell.ceiling))
    return np.asarray((heights > cell.clearance) & (self_clearance(placed) > _SELF_CLEARANCE))


def visible(cell: CellBodies, name: str, q: Array, others: Mapping[str, Array] | None = None) -> np.ndarray:
    """Whether the tracker can see the SMR of an arm at ``q`` (n, N), shape (n,) bool.

    In the tracker's field, inside the SMR's acceptance angle (less three degrees for what is not known exactly), no
    body of the arm in the beam, nor of the others where they are given (name -> (n, N)).
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
    seen &= cosine > math.cos(max(0.0, arm.acceptance - math.radians(3.0)))
    rows = np.flatnonzero(seen)
    if len(rows):
        seen[rows] &= beam_clearance(T_C_M[:3, 3], bodies.smr[rows], bodies.take(rows), own=True) > _BEAM_RADIUS
        for other, other_q in (others or {}).items():
            other_bodies = place(cell.arms[other], other_q[rows])
            seen[rows] &= beam_clearance(T_C_M[:3, 3], bodies.smr[rows], other_bodies, own=False) > _BEAM_RADIUS
    return seen


def predicted_smr(cell: CellBodies, name: str, q: Array) -> Array:
    """Where the tracker should look for the SMR of an arm at ``q`` (n, N): (n, 3) in the tracker frame [m]."""
    if cell.field is None:
        raise ValueError("the cell has no tracker")
    T_C_M = cell.field.T_C_M
    return np.asarray((place(cell.arms[name], q).smr - T_C_M[:3, 3]) @ T_C_M[:3, :3])


def _samples(arm: ArmBodies, q_from: Array, q_to: Array, step: float) -> tuple[Array, float]:
    """Configurations along the way so close that no body point moves more than ``step`` [m] between ``_EVERY`` of them.

    Also returns how far any body point can be from where it is at the nearest of them [m]; zero for no way.
    """
    way = float(np.abs(q_to - q_from) @ arm.levers)
    count = _EVERY * max(1, math.ceil(way / step)) + 1
    return q_from + np.linspace(0.0, 1.0, count)[:, None] * (q_to - q_from), 0.5 * way / (count - 1)


def _apart(first: Placed, second: Placed, clearance: float) -> bool:
    """Whether all places of one arm keep the clearance from all places of the other."""
    along = second.start[0, 0] - first.start[0, 0]
    along = along / max(float(np.linalg.norm(along)), 1e-12)
    reach_first = np.maximum(first.start @ along, first.end @ along) + first.radius
    reach_second = np.minimum(second.start @ along, second.end @ along) - second.radius
    # only bodies that reach past the nearest of the other arm can meet it
    i, a = np.nonzero(reach_first > reach_second.min() - clearance)
    k, b = np.nonzero(reach_second < reach_first.max() + clearance)
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
        if (gap - first_radius[start : start + block, None] - second_radius).min() < clearance:
            return False
    return True


__all__ = [
    "CellBodies",
    "TrackerField",
    "between_arms",
    "clear_alone",
    "predicted_smr",
    "refuse_motion",
    "refuse_stop",
    "visible",
]
