"""Effects of the acceleration of an arm's bodies on its joints: torques of inertia, and the mass matrix.

    tau_j = z_j . sum_k (c_k - o_j) x (-m_k a_k)

over the bodies k beyond joint j; accelerations a_k are second differences of their centres along the path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.plant.config import Array
from drivers.plant.mechanism import Mechanism, Posture

_GYRATION_M = 0.05
"""Radius of gyration of each body about its centre."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies in n postures: axes (N, n, 3), points on them, centres (N, n, 3), masses (N,)."""

    axes: Array
    points: Array
    centers: Array
    masses: Array

    @classmethod
    def at(cls, mechanism: Mechanism, q: Array) -> Bodies:
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
    one, here, other = (Bodies.at(mechanism, at) for at in (before, q, after))
    acceleration = (one.centers - 2.0 * here.centers + other.centers) / step_s**2
    force = -here.masses[:, None, None] * acceleration
    moment = np.cross(here.centers, force)
    force, moment = (np.cumsum(beyond[::-1], axis=0)[::-1] for beyond in (force, moment))
    about = moment - np.cross(here.points, force)
    return np.asarray(np.einsum("jnk,jnk->nj", here.axes, about) - here.own * (before - 2.0 * q + after) / step_s**2)
