"""Arms that vibrate on their elastic joints: all masses on all springs, excited by the accelerations of the motion.

    M(q) y'' + C y' + K y = tau

y are the twists of the joints, M the mass matrix of the posture, tau the torques of inertia on the path of the drives.
It is solved mode by mode in blocks of time in which the posture hardly changes, exactly within each block. The static
part ``tau / K`` belongs to the elastic joints; vibration is the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from drivers.plant.config import Array
from drivers.plant.effect import POSITIVES, Parameters, PlantEffect, made
from drivers.plant.mechanism import Mechanism, TrueBodies, inertia_torques

_BLOCK_S = 0.2
_STIFF = 0.5
"""Modes whose phase advances by more than this in one step [rad] follow without delay."""


@dataclass(frozen=True, eq=False)
class JointVibration(PlantEffect):
    """Springs of ``stiffness`` (N,) [Nm/rad]; every mode is damped by ``damping`` of the critical one."""

    stiffness: Array
    damping: float

    def response(self, time_s: Array, q: Array, mechanism: Mechanism) -> Array | None:
        step_s = float(time_s[1] - time_s[0])
        ends = np.concatenate([q[:1], q, q[-1:]])
        torque, block = inertia_torques(mechanism, ends[:-2], q, ends[2:], step_s), max(round(_BLOCK_S / step_s), 2)
        bodies = TrueBodies.at(mechanism, q[block // 2 :: block])
        twist, speed, found = np.zeros(q.shape[1]), np.zeros(q.shape[1]), np.empty_like(q)
        for number, first in enumerate(range(0, len(q), block)):
            rows = slice(first, first + block)
            mass = bodies.mass_matrix(min(number, len(bodies.centers[0]) - 1))
            squares, shapes = scipy.linalg.eigh(np.diag(self.stiffness), mass)
            onto = shapes.T @ mass
            modal, late = self._modes(torque[rows] @ shapes, np.sqrt(squares), onto @ twist, onto @ speed, step_s)
            found[rows] = modal @ shapes.T
            twist, speed = found[rows][-1], shapes @ late
        return found - torque / self.stiffness

    def _modes(self, force: Array, rate: Array, start: Array, speed: Array, step_s: float) -> tuple[Array, Array]:
        """Return the amplitudes (n, N) of modes under forces (n, N) and their final speeds (N,), from amplitudes
        ``start`` and speeds (N,) one step before the first force."""
        decay, omega = -self.damping * rate, rate * np.sqrt(1.0 - self.damping**2)
        pole = decay + 1j * omega
        quick = rate * step_s > _STIFF
        pole[quick] = -_STIFF / step_s  # not used
        ages = step_s * np.arange(1, len(force) + 1)[:, None]
        state = speed - decay * start + 1j * omega * start
        state = np.exp(pole * ages) * (state + np.cumsum(np.exp(-pole * ages) * force * step_s, axis=0))
        amplitude = np.where(quick, force / rate**2, state.imag / omega)
        late = np.where(quick, 0.0, (pole * state[-1]).imag / omega)
        return amplitude, late


def _damping(parameters: Parameters, key: str) -> float:
    damping = parameters.number(key, above=0.0)
    if damping >= 1.0:
        raise parameters.error(key, f"must be below 1, the critical one, not {damping:g}")
    return damping


joint_vibration = made(JointVibration, stiffness=POSITIVES, damping=_damping)
"""``stiffness`` [Nm/rad] per joint; ``damping``, a share of the critical one."""
