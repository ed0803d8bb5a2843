"""Gravity on an arm at rest: weights, moments and joint torques from masses and centres of mass in the D-H frames.

Every function sums point masses: for masses m_k at c_k, the moment about a point o is ``sum_k (c_k - o) x m_k g``.
Frames are those of ``chain.frame_poses``, base first. All vectors are in the tracker frame M.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellapp.robot.kinematics.chain import Geometry, frame_poses
from cellapp.robot.kinematics.transforms import Array

STANDARD_GRAVITY = 9.80665  # m/s^2, CODATA conventional value
_ROUNDING = 1e-6
"""A torque that never exceeds this [Nm] is rounding error."""


@dataclass(frozen=True)
class Bodies:
    """Masses of an arm and of its payload.

    Attributes
    ----------
    masses : array, shape (N,)
        Of the body fixed to D-H frame i [kg].
    centers : array, shape (N, 3)
        Their centres of mass in that frame [m].
    payload_mass : float
        In the flange [kg].
    payload_center : array, shape (3,)
        In the flange frame [m].
    """

    masses: Array
    centers: Array
    payload_mass: float
    payload_center: Array


@dataclass(frozen=True)
class GravityLoads:
    """The point masses of an arm at n configurations: N bodies, then the payload.

    Attributes
    ----------
    rotations : array, shape (N + 1, n, 3, 3)
    origins : array, shape (N + 1, n, 3) [m]
        The D-H frames, base first.
    masses : array, shape (N + 1, n) [kg]
    centers : array, shape (N + 1, n, 3) [m]
    gravity : array, shape (3,) [m/s^2]
    """

    rotations: Array
    origins: Array
    masses: Array
    centers: Array
    gravity: Array

    @cached_property
    def _beyond(self) -> tuple[Array, Array]:
        """Mass (N + 1, n) and first moment (N + 1, n, 3) of everything beyond D-H frame i, payload included."""
        first_moments = self.masses[:, :, None] * self.centers
        return np.cumsum(self.masses[::-1], axis=0)[::-1], np.cumsum(first_moments[::-1], axis=0)[::-1]

    @cached_property
    def _torque_by_lever(self) -> Array:
        """Factor (N, n, 3) [m/s^2]: its product with a lever from a joint is the torque of 1 kg at the lever's end."""
        return np.cross(self.gravity, self.rotations[:-1, :, :, 2])

    def beyond(self, frame: int) -> tuple[Array, Array]:
        """Compute the weight (n, 3) [N] beyond D-H frame ``frame`` and its moment (n, 3) [Nm] about the frame's origin.

        Beyond frame i are the bodies i + 1 to N and the payload; beyond frame 0 (base) is the whole arm.
        """
        mass, first_moment = self._beyond[0][frame][:, None], self._beyond[1][frame]
        return mass * self.gravity, np.cross(first_moment - mass * self.origins[frame], self.gravity)

    def joint_torques(self) -> Array:
        """Compute the gravity torque about each joint axis (n, N) [Nm], positive in the joint's positive direction.

        ``tau_j = z_j . sum over masses beyond joint j of (c_k - o_j) x m_k g``.
        """
        mass, first_moment = self._beyond
        levers = first_moment[:-1] - mass[:-1, :, None] * self.origins[:-1]
        axes = self.rotations[:-1, :, :, 2]
        return np.asarray(np.einsum("jna,jna->nj", axes, np.cross(levers, self.gravity)))

    def torques_of(self, mass: int) -> Array:
        """Compute the torque of one mass about each joint axis (n, N) [Nm]; zero for joints beyond it.

        ``mass`` counts bodies from 0; -1 or N is the payload.
        """
        joints = len(self.origins) - 1
        place = mass % (joints + 1)
        levers = self.centers[place] - self.origins[:-1]
        torques = np.einsum("jna,jna->nj", self._torque_by_lever, levers) * self.masses[place][:, None]
        torques[:, place + 1 :] = 0.0
        return without_rounding(torques)


def without_rounding(torques: Array) -> Array:
    """Return torques (n, ...) [Nm], exact zeros where all n are rounding error, which a search would take for a law."""
    return np.where(np.abs(torques).max(axis=0, initial=0.0) > _ROUNDING, torques, 0.0)


def gravity_loads(
    frames: tuple[Array, Array],
    bodies: Bodies,
    up_M: Array,
    payload_kg: Array | None = None,
    payload_center_F: Array | None = None,
) -> GravityLoads:
    """Place the masses of an arm in the tracker frame.

    Parameters
    ----------
    frames : rotations (N + 1, n, 3, 3) and origins (N + 1, n, 3) [m]
        From ``chain.frame_poses``.
    bodies : Bodies
    up_M : array, shape (3,)
        Unit vector against gravity in the tracker frame.
    payload_kg : array, shape (n,), optional
        Payload at each configuration; ``bodies.payload_mass`` where it is NaN or not given.
    payload_center_F : array, shape (n, 3), optional
        Its centre in the flange frame [m]; ``bodies.payload_center`` where it is NaN or not given.
    """
    rotations, origins = frames
    n = origins.shape[1]
    payload = np.full(n, bodies.payload_mass)
    if payload_kg is not None:
        payload = np.where(np.isnan(payload_kg), payload, payload_kg)
    masses = np.concatenate([np.tile(bodies.masses[:, None], (1, n)), payload[None]])
    of_bodies = origins[1:] + np.einsum("inab,ib->ina", rotations[1:], bodies.centers)
    if payload_center_F is None:
        of_payload = origins[-1] + rotations[-1] @ bodies.payload_center
    else:
        center = np.where(np.isnan(payload_center_F), bodies.payload_center, payload_center_F)
        of_payload = origins[-1] + np.einsum("nab,nb->na", rotations[-1], center)
    centers = np.concatenate([of_bodies, of_payload[None]])
    return GravityLoads(rotations, origins, masses, centers, -STANDARD_GRAVITY * up_M)


def base_moment(geometry: Geometry, bodies: Bodies, q: Array, up_M: Array, payload_kg: Array | None = None) -> Array:
    """Compute the gravity moment of the arm about its base origin (n, 3) [Nm] at configurations ``q`` (n, N) [rad]."""
    return gravity_loads(frame_poses(geometry, q), bodies, up_M, payload_kg).beyond(0)[1]
