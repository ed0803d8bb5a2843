"""Gravity torques of an arm at rest, from masses and centres of mass in the D-H frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.kinematics.chain import Geometry, frame_poses
from cellapp.kinematics.transforms import Array

STANDARD_GRAVITY = 9.80665  # m/s^2, CODATA conventional value


@dataclass(frozen=True)
class Bodies:
    """What hangs on the frames of an arm.

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


def gravity_torques(
    geometry: Geometry, bodies: Bodies, q: Array, up_M: Array, payload_kg: Array | None = None
) -> Array:
    """Torque of gravity about each joint axis, shape (n, N) [Nm], positive where it turns the joint forwards.

    ``tau_j = z_j . sum over bodies beyond j of (c_k - o_j) x m_k g``.

    Parameters
    ----------
    geometry : Geometry
    bodies : Bodies
    q : array, shape (n, N) [rad]
    up_M : array, shape (3,)
        Unit vector against gravity in the tracker frame.
    payload_kg : array, shape (n,), optional
        Payload at each configuration; ``bodies.payload_mass`` where it is NaN or not given.
    """
    rotations, origins = frame_poses(geometry, q)
    n, joints = q.shape
    payload = np.full(n, bodies.payload_mass)
    if payload_kg is not None:
        payload = np.where(np.isnan(payload_kg), payload, payload_kg)
    centers = origins[1:] + np.einsum("inab,ib->ina", rotations[1:], bodies.centers)
    load = origins[-1] + rotations[-1] @ bodies.payload_center
    torques = np.empty((n, joints))
    first_moment, mass = payload[:, None] * load, payload.copy()
    for j in range(joints - 1, -1, -1):
        first_moment = first_moment + bodies.masses[j] * centers[j]
        mass = mass + bodies.masses[j]
        lever = first_moment - mass[:, None] * origins[j]
        torques[:, j] = np.einsum("na,na->n", rotations[j][:, :, 2], np.cross(lever, -STANDARD_GRAVITY * up_M))
    return torques
