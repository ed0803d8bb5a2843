"""Arms as capsules: distances of bodies from one another, the floor and the tracker's beam. Frame C, metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellapp.kinematics.chain import Geometry, frame_poses
from cellapp.kinematics.transforms import Array

_TOUCHING_FRAMES = 2
"""Bodies whose D-H frames are this close always touch: they share a joint housing."""


@dataclass(frozen=True)
class ArmBodies:
    """An arm as it stands in the cell, for collision and visibility.

    Attributes
    ----------
    geometry : Geometry
        The best known chain, its base in the cell frame C.
    frames : array, shape (m,), int
        D-H frame of each capsule.
    start, end : array, shape (m, 3)
        Ends of each capsule's segment in its frame [m].
    radius : array, shape (m,)
    limits : array, shape (N, 2)
        Joint limits [rad].
    normal_F : array, shape (3,)
        The way the SMR looks, in the flange frame.
    acceptance : float
        Half-angle of the SMR [rad].
    """

    geometry: Geometry
    frames: np.ndarray
    start: Array
    end: Array
    radius: Array
    limits: Array
    normal_F: Array
    acceptance: float

    @cached_property
    def levers(self) -> Array:
        """How far from each joint's axis any point of the bodies can get, shape (N,) [m]."""
        joints = self.geometry.joints
        zero = np.zeros((1, joints))
        origins, bodies = frame_poses(self.geometry, zero)[1][:, 0], place(self, zero)
        # neither a frame's distance from the one before nor a body's from the frame before its own changes with q
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(origins, axis=0), axis=1))])
        before = np.maximum(self.frames - 1, 0)
        ends = np.stack([bodies.start[0], bodies.end[0]])
        reach = np.linalg.norm(ends - origins[before], axis=2).max(axis=0) + self.radius + along[before]
        carried = self.frames[:, None] > np.arange(joints)
        return np.asarray(np.where(carried, reach[:, None] - along[:-1], 0.0).max(axis=0, initial=0.0))


@dataclass(frozen=True)
class Placed:
    """Bodies of n configurations: segment ends (n, m, 3), SMR centre and the way it looks (n, 3), all in C."""

    start: Array
    end: Array
    radius: Array
    frames: np.ndarray
    smr: Array
    normal: Array

    def take(self, rows: np.ndarray | slice) -> Placed:
        """Some of the configurations."""
        return Placed(self.start[rows], self.end[rows], self.radius, self.frames, self.smr[rows], self.normal[rows])


def place(arm: ArmBodies, q: Array) -> Placed:
    """The bodies at configurations ``q`` (n, N)."""
    rotations, origins = frame_poses(arm.geometry, q)
    R, o = rotations[arm.frames], origins[arm.frames]
    return Placed(
        start=(o + np.einsum("mnab,mb->mna", R, arm.start)).transpose(1, 0, 2),
        end=(o + np.einsum("mnab,mb->mna", R, arm.end)).transpose(1, 0, 2),
        radius=arm.radius,
        frames=arm.frames,
        smr=origins[-1] + rotations[-1] @ arm.geometry.tool,
        normal=rotations[-1] @ arm.normal_F,
    )


def segment_distance(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """Distances (...) between segments a0-a1 and b0-b1, each (..., 3), that broadcast; points are segments too.

    The nearest points are found by minimising over one segment, clamping, then the other: Ericson, Real-Time Collision
    Detection (2005), section 5.1.9.
    """
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    uw, vw = _dot(u, w), _dot(v, w)
    tiny = 1e-18
    denominator = uu * vv - uv * uv
    s = np.where(denominator > tiny, (uv * vw - vv * uw) / np.where(denominator > tiny, denominator, 1.0), 0.0)
    s = np.clip(s, 0.0, 1.0)
    t = np.clip(np.where(vv > tiny, (uv * s + vw) / np.where(vv > tiny, vv, 1.0), 0.0), 0.0, 1.0)
    s = np.clip(np.where(uu > tiny, (uv * t - uw) / np.where(uu > tiny, uu, 1.0), 0.0), 0.0, 1.0)
    gap = w + s[..., None] * u - t[..., None] * v
    return np.asarray(np.sqrt(_dot(gap, gap)))


def self_clearance(placed: Placed) -> Array:
    """Smallest distance between bodies of one arm that do not touch by build, shape (n,) [m]; infinite without any."""
    i, k = np.triu_indices(len(placed.radius), 1)
    apart = np.abs(placed.frames[i] - placed.frames[k]) > _TOUCHING_FRAMES
    i, k = i[apart], k[apart]
    if len(i) == 0:
        return np.full(len(placed.smr), np.inf)
    gap = segment_distance(placed.start[:, i], placed.end[:, i], placed.start[:, k], placed.end[:, k])
    return np.asarray((gap - placed.radius[i] - placed.radius[k]).min(axis=1))


def floor_clearance(placed: Placed, floor: float) -> Array:
    """Smallest height above the floor of bodies that can move up and down, shape (n,) [m]; infinite without any."""
    moving = _moving(placed)
    if not moving.any():
        return np.full(len(placed.smr), np.inf)
    lowest = np.minimum(placed.start[:, moving, 2], placed.end[:, moving, 2]) - placed.radius[moving]
    return np.asarray(lowest.min(axis=1) - floor)


def ceiling_clearance(placed: Placed, ceiling: float) -> Array:
    """Smallest depth below the ceiling of bodies that can move up and down, shape (n,) [m]; infinite without any."""
    moving = _moving(placed)
    if not moving.any():
        return np.full(len(placed.smr), np.inf)
    highest = np.maximum(placed.start[:, moving, 2], placed.end[:, moving, 2]) + placed.radius[moving]
    return np.asarray(ceiling - highest.max(axis=1))


def _moving(placed: Placed) -> np.ndarray:
    """Which bodies can move up and down: column and shoulder only turn about the first axis."""
    return np.asarray(placed.frames > 1)


def between_arms(first: Placed, second: Placed) -> Array:
    """Smallest distance between two arms, configuration by configuration, shape (n,) [m]."""
    gap = segment_distance(first.start[:, :, None], first.end[:, :, None], second.start[:, None], second.end[:, None])
    return np.asarray((gap - first.radius[:, None] - second.radius).min(axis=(1, 2)))


def beam_clearance(tracker: Array, target: Array, bodies: Placed, *, own: bool) -> Array:
    """Smallest distance of a beam's axis from the bodies, shape (n,) [m].

    With ``own``, the bodies carry the target (n, 3): what is fixed to the last frame with bodies is left out, for it
    always stands where the beam ends.
    """
    seen = bodies.frames < bodies.frames.max(initial=0) if own else np.ones(len(bodies.frames), dtype=bool)
    if not seen.any():
        return np.full(len(target), np.inf)
    gap = segment_distance(
        np.broadcast_to(tracker, target.shape)[:, None], target[:, None], bodies.start[:, seen], bodies.end[:, seen]
    )
    return np.asarray((gap - bodies.radius[seen]).min(axis=1))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...a,...a->...", a, b))
