"""Arms as capsules, and distances between them, to the floor and to the tracker's beam. Cell frame C, metres.

How the tracker sees an SMR, and each condition under which it can be measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.shapes import ObstacleBody
from cellapp.robot.kinematics.chain import Geometry, frame_poses, frame_vectors
from cellapp.robot.kinematics.transforms import Array

_TOUCHING_FRAMES = 2
"""Capsules whose D-H frame numbers differ by at most this always overlap: they share a joint housing."""
_ROUNDING_M = 1e-6
"""Tolerance for rounding between two distances from one obstacle: of the SMR, and of the beam that ends there [m]."""


@dataclass(frozen=True, eq=False)
class ArmBodies:
    """One arm in the cell, for collision and visibility.

    Attributes
    ----------
    geometry : Geometry
        Chain with its base in the cell frame C, identified where a calibration exists.
    frames : array, shape (m,), int
        Number of the D-H frame to which each capsule is fixed; 0 is the base.
    start, end : array, shape (m, 3)
        Ends of each capsule's axis in that frame [m].
    radius : array, shape (m,)
        Radius of each capsule [m].
    limits : array, shape (N, 2)
        Joint limits [rad].
    normal_F : array, shape (3,)
        SMR viewing direction in the flange frame, a unit vector.
    acceptance : float
        Half the acceptance angle of the SMR [rad].
    mounted : tuple of ObstacleBody
        Obstacles fixed to the flange, their poses in the flange frame. The last capsules cover them.
    covered : tuple of str
        Names of the mounted obstacles that the last ``len(covered)`` capsules cover.
    """

    geometry: Geometry
    frames: np.ndarray
    start: Array
    end: Array
    radius: Array
    limits: Array
    normal_F: Array
    acceptance: float
    mounted: tuple[ObstacleBody, ...] = ()
    covered: tuple[str, ...] = ()

    @property
    def links(self) -> int:
        """Number of capsules of the arm itself, which come first."""
        return len(self.radius) - len(self.covered)

    @cached_property
    def ends(self) -> Array:
        """Both ends of each capsule's axis in its frame, homogeneous, shape (m, 2, 4) [m]."""
        both = np.stack([self.start, self.end], axis=1)
        return np.concatenate([both, np.ones((len(both), 2, 1))], axis=2)

    @cached_property
    def extents(self) -> Array:
        """Radius of the sphere about each capsule, shape (m,) [m]."""
        return np.asarray(0.5 * np.linalg.norm(self.end - self.start, axis=1) + self.radius)

    @cached_property
    def tool(self) -> Array:
        """SMR centre in the flange frame, homogeneous, shape (4,) [m]."""
        return np.append(self.geometry.tool, 1.0)

    @cached_property
    def moving(self) -> np.ndarray:
        """Indices of bodies that can move vertically: base and shoulder only rotate about the first axis."""
        return np.flatnonzero(self.frames > 1)

    @cached_property
    def levers(self) -> Array:
        """Upper bound on the distance of any body point from each joint's axis, over all q, shape (N,) [m]."""
        return np.asarray(self.body_levers.max(axis=0, initial=0.0))

    @cached_property
    def body_levers(self) -> Array:
        """Upper bound on the distance of any point of a body from each joint's axis, over all q, shape (m, N) [m].

        It is the path length along the chain, as the distances between successive frames, and of a body from the frame
        before its own, do not depend on q. Zero for joints that do not move the body.
        """
        joints = self.geometry.joints
        zero = np.zeros((1, joints))
        origins, bodies = frame_poses(self.geometry, zero)[1][:, 0], place(self, zero)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(origins, axis=0), axis=1))])
        before = np.maximum(self.frames - 1, 0)
        ends = np.stack([bodies.start[0], bodies.end[0]])
        reach = np.linalg.norm(ends - origins[before], axis=2).max(axis=0) + self.radius + along[before]
        carried = self.frames[:, None] > np.arange(joints)
        return np.asarray(np.where(carried, reach[:, None] - along[:-1], 0.0))

    @cached_property
    def own_pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of bodies that do not overlap by design: their indices, (p,) int each."""
        i, k = np.triu_indices(len(self.radius), 1)
        apart = np.abs(self.frames[i] - self.frames[k]) > _TOUCHING_FRAMES
        return i[apart], k[apart]

    @cached_property
    def pair_levers(self) -> Array:
        """Like ``body_levers``, for the motion of one body of ``own_pairs`` relative to the other, (p, N) [m]."""
        i, k = self.own_pairs
        low, high = np.minimum(self.frames[i], self.frames[k]), np.maximum(self.frames[i], self.frames[k])
        outer = np.where(self.frames[i] > self.frames[k], i, k)
        joints = np.arange(self.geometry.joints)
        between = (joints >= low[:, None]) & (joints < high[:, None])
        return np.asarray(np.where(between, self.body_levers[outer], 0.0))


@dataclass(frozen=True, eq=False)
class Placed:
    """Bodies of one arm at n configurations, in the cell frame C.

    Attributes
    ----------
    arm : ArmBodies
    start, end : array, shape (n, m, 3)
        Ends of the capsules' axes [m]. Configurations are contiguous in memory: sums over components are then fastest.
    smr : array, shape (n, 3)
        SMR centre [m].
    flange : array, shape (n, 3, 3)
        Rotation of the flange frame.
    """

    arm: ArmBodies
    start: Array
    end: Array
    smr: Array
    flange: Array

    @property
    def radius(self) -> Array:
        """Radius of each capsule, shape (m,) [m]."""
        return self.arm.radius

    @property
    def frames(self) -> np.ndarray:
        """Number of the D-H frame to which each capsule is fixed, shape (m,)."""
        return self.arm.frames

    @property
    def normal(self) -> Array:
        """Viewing direction of the SMR, shape (n, 3)."""
        return np.asarray(self.flange @ self.arm.normal_F)

    def axes(self, rows: np.ndarray, bodies: np.ndarray) -> tuple[Array, Array]:
        """Return both ends of the axes of some ``bodies`` (p,), at configurations ``rows`` (p,), (3, p) each [m]."""
        return self.start.T[:, bodies, rows], self.end.T[:, bodies, rows]

    def take(self, rows: np.ndarray | slice) -> Placed:
        """Select some of the configurations."""
        start, end = (np.ascontiguousarray(ends.T[..., rows]).T for ends in (self.start, self.end))
        return Placed(self.arm, start, end, self.smr[rows], self.flange[rows])


def place(arm: ArmBodies, q: Array) -> Placed:
    """Place the bodies at configurations ``q`` (n, N) [rad]."""
    frames = frame_vectors(arm.geometry, q)
    ends = arm.ends @ frames[:, arm.frames]
    flange = frames[:, -1]
    return Placed(
        arm=arm,
        start=ends[:, :, 0].transpose(2, 1, 0),
        end=ends[:, :, 1].transpose(2, 1, 0),
        smr=np.ascontiguousarray((arm.tool @ flange).T),
        flange=np.ascontiguousarray(flange[:, :3].transpose(2, 0, 1)),
    )


def segment_distance(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """Compute distances (...) [m] between segments a0-a1 and b0-b1, ends (..., 3) that broadcast.

    A segment may be a point. Source: Ericson, Real-Time Collision Detection (2005), section 5.1.9: minimise over one
    segment, clamp, then over the other.
    """
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    uw, vw = _dot(u, w), _dot(v, w)
    s = _share(uv * vw - vv * uw, uu * vv - uv * uv)  # parallel segments: any s will do
    t = _share(uv * s + vw, vv)
    s = _share(uv * t - uw, uu)
    gap = w + s[..., None] * u
    gap -= t[..., None] * v
    return np.asarray(np.sqrt(_dot(gap, gap)))


def pair_gaps(placed: Placed, i: np.ndarray, k: np.ndarray, within: Array | float = np.inf) -> Array:
    """Compute distances (n, p) [m] between bodies ``i`` and ``k`` (p,) of one arm; negative where their surfaces meet.

    Distances beyond ``within`` [m], (n, p) or what broadcasts to it, may be underestimated, but not below it: there a
    lower bound from bounding spheres is used, which takes a twentieth of the time.
    """
    start, end = placed.start.T, placed.end.T  # contiguous in memory, hence fast to copy
    size, extent = placed.radius, placed.arm.extents
    middle = 0.5 * (start + end)
    between = middle[:, i] - middle[:, k]
    gaps = np.sqrt(np.einsum("apn,apn->pn", between, between)) - (extent[i] + extent[k])[:, None]
    near = ~(gaps > np.broadcast_to(within, gaps.T.shape).T)  # also for NaN
    pair, row = np.nonzero(near)
    ends = (whole[:, one[pair], row].T for one in (i, k) for whole in (start, end))
    gaps[near] = segment_distance(*ends) - size[i[pair]] - size[k[pair]]
    return np.asarray(gaps.T)


def self_clearance(placed: Placed, within: float = np.inf) -> Array:
    """Compute the smallest distance between capsules of one arm that do not overlap by design, (n,) [m].

    Infinite without such capsules. A distance beyond ``within`` may be underestimated, but not below it.
    """
    i, k = placed.arm.own_pairs
    if len(i) == 0:
        return np.full(len(placed.smr), np.inf)
    return np.asarray(pair_gaps(placed, i, k, within).min(axis=1))


def height_clearance(placed: Placed, floor: float = -math.inf, ceiling: float = math.inf) -> Array:
    """Compute the smallest distance of moving bodies from heights ``floor`` below and ``ceiling`` above, (n,) [m].

    Infinite without moving bodies.
    """
    moving = placed.arm.moving
    if not len(moving):
        return np.full(len(placed.smr), np.inf)
    ends, radius = np.stack([placed.start[:, moving, 2], placed.end[:, moving, 2]]), placed.radius[moving]
    lowest, highest = (ends.min(axis=0) - radius).min(axis=1), (ends.max(axis=0) + radius).max(axis=1)
    return np.asarray(np.minimum(lowest - floor, ceiling - highest))


def beam_clearance(tracker: Array, target: Array, bodies: Placed, *, own: bool) -> Array:
    """Compute the smallest distance of bodies from the beam from ``tracker`` (3,) to ``target`` (n, 3), shape (n,) [m].

    ``own`` says that the bodies carry the target. Then those fixed to the last frame that has bodies are left out, as
    they are always at the end of the beam, and so are the covers of mounted obstacles (see ``mounted_hides``).
    """
    seen = np.ones(len(bodies.frames), dtype=bool)
    if own:
        links = bodies.arm.links
        seen = (np.arange(len(seen)) < links) & (bodies.frames < bodies.frames[:links].max(initial=0))
    if not seen.any():
        return np.full(len(target), np.inf)
    gap = segment_distance(
        np.broadcast_to(tracker, target.shape)[:, None], target[:, None], bodies.start[:, seen], bodies.end[:, seen]
    )
    return np.asarray((gap - bodies.radius[seen]).min(axis=1))


def mounted_hides(tracker: Array, bodies: Placed, radius: float) -> np.ndarray:
    """Return whether obstacles mounted on an arm hide its own SMR from ``tracker`` (3,), shape (n,) bool.

    An obstacle closer to the SMR's centre than ``radius`` [m] hides it if the beam comes still closer. One that
    encloses the SMR is its holder, and hides nothing.
    """
    hidden = np.zeros(len(bodies.smr), dtype=bool)
    if not bodies.arm.mounted:
        return hidden
    tool = bodies.arm.geometry.tool
    source = np.einsum("nba,nb->na", bodies.flange, tracker - bodies.smr) + tool
    target = np.broadcast_to(tool, source.shape)
    for obstacle in bodies.arm.mounted:
        smr_gap = float(obstacle.gaps(tool[None], tool[None], 0.0, radius)[0])
        if smr_gap > 0.0:
            needed = min(radius, smr_gap - _ROUNDING_M)
            hidden |= ~(obstacle.gaps(source, target, 0.0, needed) >= needed)
    return hidden


def _dot(a: Array, b: Array) -> Array:
    product: Array = np.einsum("...a,...a->...", a, b)
    return product


def _share(numerator: Array, denominator: Array) -> Array:
    """Divide and clip to 0 to 1; 0 where the denominator vanishes (points and parallel segments, in m^2 or m^4)."""
    regular = denominator > 1e-18
    if np.all(regular):
        found = np.asarray(numerator / denominator)
    else:
        found = np.divide(numerator, denominator, out=np.zeros_like(numerator), where=regular)
    np.maximum(found, 0.0, out=found)  # keeps NaN, as does the next line
    return np.minimum(found, 1.0, out=found)


_ACCEPTANCE_MARGIN = math.radians(3.0)
"""Subtracted from the SMR's acceptance angle, as base and flange are not known exactly before calibration."""

RANGE, AZIMUTH, ELEVATION, FACING = "range", "azimuth", "elevation", "facing"
"""Names of the conditions on an SMR that do not depend on bodies."""


@dataclass(frozen=True, eq=False)
class Sight:
    """SMRs as the tracker sees them; n stands for any shape.

    Attributes
    ----------
    smr_M : array, shape (3, n)
        SMR centres in the tracker frame M [m].
    distance : array, shape (n)
        From the tracker [m].
    cosine : array, shape (n)
        Cosine of the incidence.
    """

    smr_M: Array
    distance: Array
    cosine: Array

    @property
    def azimuth(self) -> Array:
        """Azimuth in the tracker frame [rad]."""
        return np.asarray(np.arctan2(self.smr_M[1], self.smr_M[0]))

    @property
    def sine_of_elevation(self) -> Array:
        """Sine of the elevation; NaN at the tracker itself."""
        return np.asarray(self.smr_M[2] / self.distance)

    @property
    def incidence(self) -> Array:
        """Angle between the SMR's viewing direction and the direction to the tracker [rad]."""
        return np.asarray(np.arccos(np.clip(self.cosine, -1.0, 1.0)))


def sight_of(T_C_M: Array, placed: Placed) -> Sight:
    """Compute how the tracker at ``T_C_M`` (4, 4) sees the SMRs of an arm at n configurations."""
    from_tracker = placed.smr - T_C_M[:3, 3]
    distance = np.linalg.norm(from_tracker, axis=1)
    with np.errstate(invalid="ignore"):  # an SMR at the tracker gives NaN, which counts as not seen
        cosine = -np.einsum("na,na->n", from_tracker, placed.normal) / distance
    return Sight((from_tracker @ T_C_M[:3, :3]).T, distance, cosine)


def usable_acceptance(acceptance: float) -> float:
    """Return the largest incidence that is planned for an SMR with half the acceptance angle ``acceptance`` [rad]."""
    return max(0.0, acceptance - _ACCEPTANCE_MARGIN)


def sight_conditions(field: TrackerField, acceptance: float, sight: Sight) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield each condition on the SMRs and where it holds, shape (n): distance, directions, incidence. NaN fails."""
    low, high = field.distance
    yield RANGE, (sight.distance >= low) & (sight.distance <= high)
    left, right = field.azimuth
    if right - left < 2.0 * math.pi:
        yield AZIMUTH, np.asarray(np.mod(sight.azimuth - left, 2.0 * math.pi) <= right - left)
    lowest, highest = np.sin(np.clip(field.elevation, -0.5 * math.pi, 0.5 * math.pi))
    sine = sight.sine_of_elevation
    yield ELEVATION, (sine >= lowest) & (sine <= highest)
    yield FACING, sight.cosine > math.cos(usable_acceptance(acceptance))


@dataclass(frozen=True)
class TrackerField:
    """Field of view of the tracker at pose ``T_C_M`` (4, 4) in the cell frame C: ranges in the tracker frame.

    ``azimuth`` and ``elevation`` in [rad], the azimuth range may cross the cut at pi; ``distance`` in [m].
    """

    T_C_M: Array
    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    distance: tuple[float, float]
