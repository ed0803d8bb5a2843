"""An arm as axes in space with bodies on them: product of exponentials, and gravity on the bodies.

The D-H table only serves to place axes and bodies at the zero position. Each joint is then a rotation about a line that
is fixed in the base frame at the zero position (Brockett's product of exponentials), written with Rodrigues' formula as
``I + sin(q) K + (1 - cos(q)) K^2`` and a point of the line.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drivers.plant.config import ArmConfig, Array, CapsuleConfig, TrueErrors
from drivers.plant.transforms import across, cross_matrix, inverse, rigid, transform_points

STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True, eq=False)
class Deflection:
    """Deviation from the ideal arm; None: no deviation. Twists: translation [m], rotation vector [rad].

    Attributes
    ----------
    joints : array, shape (n, N)
        True minus reported joint angle [rad].
    base : array, shape (n, 6)
        Twist of the base, in B.
    links : array, shape (n, N, 6)
        Twist of D-H frame i relative to joint i, in that frame.
    tool : array, shape (n, 6)
        Twist of the tool, in the flange frame.
    """

    joints: Array | None = None
    base: Array | None = None
    links: Array | None = None
    tool: Array | None = None


NO_DEFLECTION = Deflection()


@dataclass(frozen=True, eq=False)
class Load:
    """Loads of the flange at n stops: masses (n,) [kg], centres (n, 3) [m] in the flange frame."""

    mass: Array
    center: Array


def _sum(one: Array | None, other: Array | None) -> Array | None:
    if one is None or other is None:
        return other if one is None else one
    return one + other


def combined(parts: Iterable[Deflection]) -> Deflection:
    """Return the sum of small deflections."""
    whole = NO_DEFLECTION
    for part in parts:
        whole = Deflection(
            joints=_sum(whole.joints, part.joints),
            base=_sum(whole.base, part.base),
            links=_sum(whole.links, part.links),
            tool=_sum(whole.tool, part.tool),
        )
    return whole


@dataclass(frozen=True, eq=False)
class Capsules:
    """Segments at the zero position in B: ``starts``, ``ends`` (k, 3), ``radii`` (k,), on bodies ``frames`` (k,)."""

    frames: np.ndarray
    starts: Array
    ends: Array
    radii: Array


@dataclass(frozen=True, eq=False)
class Mechanism:
    """N lines, N bodies, a flange and an SMR, all at the zero position, in B.

    Attributes
    ----------
    directions, points : arrays, shape (N, 3)
        Unit direction of each axis and a point on it.
    zeros : array, shape (N,)
        True joint angle when the controller reports zero [rad].
    frames : array, shape (N + 1, 4, 4)
        D-H frames 0 to N.
    masses, centers : arrays, shapes (N,), (N, 3)
        Bodies; the last one without the payload.
    payload_mass, payload_center : float, array (3,)
        Payload, in the flange frame.
    smr, smr_normal : arrays, shape (3,)
        In the flange frame.
    probe : array, shape (3, 3), or None
        Rotation of a 6-D probe in the flange frame.
    """

    directions: Array
    points: Array
    zeros: Array
    frames: Array
    masses: Array
    centers: Array
    payload_mass: float
    payload_center: Array
    smr: Array
    smr_normal: Array
    capsules: Capsules
    probe: Array | None = None

    @cached_property
    def _rotations(self) -> Array:
        """Factors of sin(q), 1 - cos(q) and 1 in each joint's transform, as rows, (N, 3, 16)."""
        cross = cross_matrix(self.directions)
        rotations = np.zeros((len(cross), 3, 4, 4))
        for k, matrix in enumerate((cross, cross @ cross)):
            rotations[:, k, :3, :3] = matrix
            rotations[:, k, :3, 3] = -(matrix @ self.points[:, :, None])[..., 0]
        rotations[:, 2] = np.eye(4)
        return rotations.reshape(-1, 3, 16)

    @cached_property
    def _lines(self) -> Array:
        """Direction and point of each axis as columns, (N, 4, 2)."""
        lines = np.zeros((len(self.directions), 4, 2))
        lines[:, :3, 0] = self.directions
        lines[:, :3, 1] = self.points
        lines[:, 3, 1] = 1.0
        return lines

    @cached_property
    def _bodies(self) -> tuple[Array, Array]:
        """First moment and mass of each body without payload, as columns (N, 4, 1); mass beyond each joint (N,)."""
        moments = np.concatenate([self.masses[:, None] * self.centers, self.masses[:, None]], axis=1)
        return moments[:, :, None], np.cumsum(self.masses[::-1])[::-1]

    def placements(self, q: Array, bend: Deflection) -> Array:
        """Return the transform in B (N, n, 4, 4) of each body from its zero position, at reported angles ``q`` (n, N).

        The joint is the first axis, so that one matrix product covers all configurations of a joint.
        """
        angles = q + self.zeros
        if bend.joints is not None:
            angles = angles + bend.joints
        n, joints = angles.shape
        factors = np.ones((joints, n, 3))
        np.sin(angles.T, out=factors[:, :, 0])
        np.subtract(1.0, np.cos(angles.T), out=factors[:, :, 1])
        rotations = (factors @ self._rotations).reshape(joints, n, 4, 4)
        if bend.links is not None:
            frames = self.frames[1:, None]
            rotations = rotations @ (frames @ rigid(bend.links.swapaxes(0, 1)) @ inverse(frames))
        if bend.base is not None:
            rotations[0] = rigid(bend.base) @ rotations[0]
        for i in range(1, joints):
            rotations[i] = rotations[i - 1] @ rotations[i]
        return rotations


@dataclass(frozen=True, eq=False)
class Posture:
    """A mechanism at n vectors of reported joint angles with the deflection ``bend``; all in B, computed on demand.

    ``gravity`` (3,) is the acceleration of free fall in B [m/s^2]. ``load`` is the load of the flange; None: the
    mechanism's payload. ``inertia`` (n, N) are torques of inertia in motion [Nm]; None: none.
    """

    mechanism: Mechanism
    q: Array
    gravity: Array
    bend: Deflection = NO_DEFLECTION
    load: Load | None = None
    inertia: Array | None = None

    @cached_property
    def placements(self) -> Array:
        """Transform of each body from its zero position, (N, n, 4, 4)."""
        return self.mechanism.placements(self.q, self.bend)

    @cached_property
    def base(self) -> Array:
        """Transform of the base, (n, 4, 4)."""
        if self.bend.base is None:
            return np.broadcast_to(np.eye(4), (len(self.q), 4, 4))
        return rigid(self.bend.base)

    def _transformed(self, motions: Array, columns: Array) -> Array:
        """Return homogeneous ``columns`` (N, 4, k) transformed by ``motions`` (N, n, 4, 4): (N, n, 3, k)."""
        joints, n = motions.shape[:2]
        transformed: Array = (motions.reshape(joints, 4 * n, 4) @ columns).reshape(joints, n, 4, -1)
        return transformed[:, :, :3]

    @cached_property
    def axes(self) -> tuple[Array, Array]:
        """Direction and point of each axis in this posture, (N, n, 3) each."""
        carriers = np.concatenate([self.base[None], self.placements[:-1]])
        lines = self._transformed(carriers, self.mechanism._lines)
        return lines[..., 0], lines[..., 1]

    @cached_property
    def load_mass(self) -> Array:
        """Mass of the load, (n,) [kg]."""
        if self.load is None:
            return np.full(len(self.q), self.mechanism.payload_mass)
        return self.load.mass

    @cached_property
    def load_moment(self) -> Array:
        """First moment of the load, (n, 3) [kg m]."""
        center = self.mechanism.payload_center if self.load is None else self.load.center
        moment: Array = self.load_mass[:, None] * transform_points(
            self.placements[-1] @ self.mechanism.frames[-1], center
        )
        return moment

    @cached_property
    def first_moments(self) -> Array:
        """First moment of each body, the load included, (N, n, 3) [kg m]."""
        moments = self._transformed(self.placements, self.mechanism._bodies[0])[..., 0]
        moments[-1] += self.load_moment
        return moments

    @cached_property
    def masses_beyond(self) -> Array:
        """Mass beyond each joint, (N, n) [kg]."""
        return self.mechanism._bodies[1][:, None] + self.load_mass

    @cached_property
    def torques(self) -> Array:
        """Torque of gravity and inertia about each axis, (n, N) [Nm]; positive if it would increase the angle."""
        directions, points = self.axes
        arms = np.cumsum(self.first_moments[::-1], axis=0)[::-1]
        arms -= self.masses_beyond[..., None] * points
        torques = _torques(directions, arms, self.gravity)
        return torques if self.inertia is None else torques + self.inertia

    @cached_property
    def load_torques(self) -> Array:
        """Part of ``torques`` caused by the load, (n, N) [Nm]."""
        directions, points = self.axes
        return _torques(directions, self.load_moment - self.load_mass[:, None] * points, self.gravity)

    @cached_property
    def base_moment(self) -> Array:
        """Moment of gravity on all bodies about the origin of B, (n, 3) [Nm]."""
        return np.cross(self.first_moments.sum(axis=0), self.gravity)

    @cached_property
    def flange(self) -> Array:
        """Pose of the flange including the tool's deflection, T_B_F, (n, 4, 4)."""
        pose: Array = self.placements[-1] @ self.mechanism.frames[-1]
        if self.bend.tool is not None:
            pose = pose @ rigid(self.bend.tool)
        return pose

    @cached_property
    def smr(self) -> tuple[Array, Array]:
        """SMR centre and viewing direction, (n, 3) each."""
        return transform_points(self.flange, self.mechanism.smr), self.flange[:, :3, :3] @ self.mechanism.smr_normal

    def segments(self) -> tuple[Array, Array]:
        """Return the ends of the capsules' segments, (k, n, 3) each."""
        capsules = self.mechanism.capsules
        motions = np.concatenate([self.base[None], self.placements])[capsules.frames]
        return transform_points(motions, capsules.starts[:, None]), transform_points(motions, capsules.ends[:, None])


def _torques(directions: Array, moments: Array, gravity: Array) -> Array:
    """Return torques (n, N) about axes ``directions`` (N, n, 3) from first moments (N, n, 3) about points on them."""
    # d . (r x g) = -(d [g]) . r
    torques: Array = -((directions @ cross_matrix(gravity)) * moments).sum(axis=-1).T
    return torques


def _frames_at_zero(rows: Array) -> Array:
    """Return the D-H frames (N + 1, 4, 4) of ``rot_z(q + theta) trans(a, 0, d) rot_x(alpha)`` at q = 0."""
    frames = [np.eye(4)]
    for theta, d, a, alpha in rows:
        about_z, about_x = np.array([0.0, 0.0, d, 0.0, 0.0, theta]), np.array([a, 0.0, 0.0, alpha, 0.0, 0.0])
        frames.append(frames[-1] @ rigid(about_z) @ rigid(about_x))
    return np.array(frames)


def _capsules_at_zero(capsules: Sequence[CapsuleConfig], frames: Array) -> Capsules:
    numbers = np.array([capsule.frame for capsule in capsules], dtype=int)
    starts = np.array([capsule.start for capsule in capsules]).reshape(-1, 3)
    ends = np.array([capsule.end for capsule in capsules]).reshape(-1, 3)
    return Capsules(
        frames=numbers,
        starts=transform_points(frames[numbers], starts),
        ends=transform_points(frames[numbers], ends),
        radii=np.array([capsule.radius for capsule in capsules]),
    )


def nominal(arm: ArmConfig) -> Mechanism:
    """Return the nominal mechanism of an arm."""
    frames = _frames_at_zero(arm.rows)
    return Mechanism(
        directions=frames[:-1, :3, 2].copy(),
        points=frames[:-1, :3, 3].copy(),
        zeros=np.zeros(arm.joints),
        frames=frames,
        masses=arm.masses,
        centers=transform_points(frames[1:], arm.centers_of_mass),
        payload_mass=arm.payload_mass,
        payload_center=arm.payload_center,
        smr=arm.smr_offset,
        smr_normal=arm.smr_normal / np.linalg.norm(arm.smr_normal),
        capsules=_capsules_at_zero(arm.capsules, frames),
        probe=arm.probe,
    )


def with_errors(mechanism: Mechanism, errors: TrueErrors, rng: np.random.Generator) -> Mechanism:
    """Return the mechanism with normally distributed errors of axes, joint zeros, SMR and probe.

    The samples do not depend on the sizes, so that one size can be changed alone.
    """
    joints = len(mechanism.directions)
    sideways = across(mechanism.directions)
    shift, tilt = rng.standard_normal((2, joints, 2))
    zeros = rng.standard_normal(joints)
    smr = rng.standard_normal(3)
    probe = rigid(np.concatenate([np.zeros(3), errors.probe * rng.standard_normal(3)]))[:3, :3]
    moved = mechanism.points + errors.length * np.einsum("jk,jkx->jx", shift, sideways)
    rotated = errors.angle * np.einsum("jk,jkx->jx", tilt, sideways)
    twist = np.concatenate([np.zeros_like(rotated), rotated], axis=1)
    directions = (rigid(twist)[:, :3, :3] @ mechanism.directions[:, :, None])[..., 0]
    return replace(
        mechanism,
        points=moved,
        directions=directions,
        zeros=mechanism.zeros + errors.angle * zeros,
        smr=mechanism.smr + errors.smr * smr,
        probe=None if mechanism.probe is None else probe @ mechanism.probe,
    )


def with_true_masses(mechanism: Mechanism, sd: float, rng: np.random.Generator) -> Mechanism:
    """Return the mechanism with normally distributed relative mass errors: standard deviation ``sd``, 90 % at most."""
    share = np.clip(sd * rng.standard_normal(len(mechanism.masses)), -0.9, 0.9)
    return replace(mechanism, masses=mechanism.masses * (1.0 + share))


def gravity_torques(arm: ArmConfig, q: Array) -> Array:
    """Return the torque of gravity about each axis of the nominal, undeflected arm at ``q`` (n, N): (n, N) [Nm].

    Positive if gravity would increase the joint angle; a motor at rest applies the opposite.
    """
    gravity = arm.T_C_B[:3, :3].T @ np.array([0.0, 0.0, -STANDARD_GRAVITY])
    return Posture(nominal(arm), np.atleast_2d(np.asarray(q, dtype=np.float64)), gravity).torques


# -- Effects of the acceleration of an arm's bodies on its joints: torques of inertia, and the mass matrix ------------
#
#     tau_j = z_j . sum_k (c_k - o_j) x (-m_k a_k)
#
# over the bodies k beyond joint j; accelerations a_k are second differences of their centres along the path.


_GYRATION_M = 0.05
"""Radius of gyration of each body about its centre."""


@dataclass(frozen=True, eq=False)
class TrueBodies:
    """Bodies in n postures: axes (N, n, 3), points on them, centres (N, n, 3), masses (N,)."""

    axes: Array
    points: Array
    centers: Array
    masses: Array

    @classmethod
    def at(cls, mechanism: Mechanism, q: Array) -> TrueBodies:
        """Return the bodies of the undeflected arm at ``q`` (n, N)."""
        posture = Posture(mechanism, q, np.zeros(3))
        masses = mechanism.masses.copy()
        masses[-1] += mechanism.payload_mass
        return cls(*posture.axes, posture.first_moments / masses[:, None, None], masses)

    @property
    def own(self) -> Array:
        """Inertia (N,) of all bodies beyond a joint about their own centres."""
        return np.asarray(_GYRATION_M**2 * np.cumsum(self.masses[::-1])[::-1])

    def mass_matrix(self, row: int) -> Array:
        """Return the mass matrix (N, N) of one posture."""
        joints = np.arange(len(self.masses))
        levers = self.centers[None, :, row] - self.points[:, None, row]
        moved = np.cross(self.axes[:, None, row], levers)  # (joint, body, 3)
        moved[joints[:, None] > joints[None]] = 0.0
        return np.asarray(np.einsum("ikx,jkx,k->ij", moved, moved, self.masses) + np.diag(self.own))


def inertia_torques(mechanism: Mechanism, before: Array, q: Array, after: Array, step_s: float) -> Array:
    """Return torques of inertia (n, N) [Nm] at ``q`` (n, N); ``before`` and ``after`` are the positions one step
    earlier and one step later."""
    one, here, other = (TrueBodies.at(mechanism, at) for at in (before, q, after))
    acceleration = (one.centers - 2.0 * here.centers + other.centers) / step_s**2
    force = -here.masses[:, None, None] * acceleration
    moment = np.cross(here.centers, force)
    force, moment = (np.cumsum(beyond[::-1], axis=0)[::-1] for beyond in (force, moment))
    about = moment - np.cross(here.points, force)
    return np.asarray(np.einsum("jnk,jnk->nj", here.axes, about) - here.own * (before - 2.0 * q + after) / step_s**2)
