"""Laws of joints in motion: offsets of a joint that follow from its path, linear in one parameter each.

    play       dq_j = -h_j d_j            d the direction with history (play operator): backlash
    wind-up    dq_j = -w_j d_j |tau_j|    friction that grows with the load
    line       dq_j = a cos(c q_j) + b sin(c q_j)   transmission error, c cycles a turn
    lag        dq_j = -T_j qd_j           delay of one joint's position behind the others'
    compliance dq_j = k_j tau_j           tau = gravity + inertia: torque of all masses beyond, at their acceleration

The torque of inertia is that of point masses (``statics``): ``tau_j = z_j . sum_k (c_k - o_j) x m_k (g - a_k)``. Lags
serve motion only, as do laws of speeds that plug-ins add; the others serve commands at rest as well. What only motion
can show: lag, the part of inertia in a compliance, and lines that are denser than stops can sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from cellapp.estimation.motion.joint_path import JointPath
from cellapp.robot.effects import MotionLaw
from cellapp.robot.kinematics.chain import Geometry, frame_poses
from cellapp.robot.kinematics.statics import Bodies, gravity_loads
from cellapp.robot.kinematics.transforms import Array

_STEP_S = 0.02
"""Step of the second difference that gives accelerations of the masses: short against any motion."""


class Law(Enum):
    """A law of one joint; the value is the slug of the effect that it belongs to."""

    PLAY = "backlash"
    WINDUP = "friction_windup"
    LINE = "transmission_error"
    LAG = "tracking_lag"
    COMPLIANCE = "joint_compliance"


_UNIT = {Law.PLAY: "rad", Law.WINDUP: "rad/Nm", Law.LINE: "rad", Law.LAG: "s", Law.COMPLIANCE: "rad/Nm"}
_SD = {Law.PLAY: 1e-4, Law.WINDUP: 1e-5, Law.LINE: 3e-4, Law.LAG: 5e-3, Law.COMPLIANCE: 2e-5}
"""Prior standard deviations, several times what arms of this kind have (handbook, chapter "effects")."""


def terms_of(law: Law | MotionLaw, joints: int) -> tuple[JointTerm, ...]:
    """The parameters of a law of all joints, but for lines."""
    names = tuple(law.parameters) if isinstance(law, MotionLaw) else ("",)
    return tuple(JointTerm(law, joint, parameter=name) for joint in range(joints) for name in names)


@dataclass(frozen=True)
class JointTerm:
    """One parameter of a law: of joint ``joint`` (from 0).

    ``cycles`` a turn and ``sine`` are those of lines, ``parameter`` is its name in a law of a plug-in.
    """

    law: Law | MotionLaw
    joint: int
    cycles: int = 0
    sine: bool = False
    parameter: str = ""

    @property
    def name(self) -> str:
        """Name of the parameter, as the effects name theirs."""
        number = self.joint + 1
        if isinstance(self.law, MotionLaw):
            return f"{self.parameter}{number}"
        return {
            Law.PLAY: f"half_play{number}",
            Law.WINDUP: f"windup{number}",
            Law.LINE: f"{'sin' if self.sine else 'cos'}{self.cycles}q{number}",
            Law.LAG: f"lag{number}",
            Law.COMPLIANCE: f"compliance{number}",
        }[self.law]

    @property
    def unit(self) -> str:
        """Unit of the parameter."""
        return self.law.parameters[self.parameter].unit if isinstance(self.law, MotionLaw) else _UNIT[self.law]

    @property
    def prior_sd(self) -> float:
        """Standard deviation of its prior."""
        return self.law.parameters[self.parameter].most if isinstance(self.law, MotionLaw) else _SD[self.law]

    @property
    def needs_torques(self) -> bool:
        """Whether it depends on torques."""
        if isinstance(self.law, MotionLaw):
            return self.law.needs_torques
        return self.law in (Law.WINDUP, Law.COMPLIANCE)

    def offset(self, state: JointState) -> Array:
        """Offset of the joint (n,) per unit of the parameter [rad]."""
        j = self.joint
        if isinstance(self.law, MotionLaw):
            return self.law.offset(self.parameter, j, state.quantity)
        if self.law is Law.PLAY:
            return np.asarray(-state.direction[:, j])
        if self.law is Law.LAG:
            return np.asarray(-state.qd[:, j])
        if self.law is Law.LINE:
            return np.asarray((np.sin if self.sine else np.cos)(self.cycles * state.q[:, j]))
        if self.law is Law.WINDUP:
            return np.asarray(-state.direction[:, j] * np.abs(state.torque[:, j]))
        return np.asarray(state.torque[:, j])


@dataclass(frozen=True, eq=False)
class JointState:
    """Joint positions, speeds, directions with history and torques of all masses [Nm], each (n, N).

    ``acceleration`` computes the accelerations (n, N), which few laws need; None at rest.
    """

    q: Array
    qd: Array
    direction: Array
    torque: Array
    acceleration: Callable[[], Array] | None = None

    @property
    def qdd(self) -> Array:
        """Accelerations (n, N) [rad/s^2]."""
        return np.zeros_like(self.q) if self.acceleration is None else self.acceleration()

    def quantity(self, name: str) -> Array:
        """What laws of plug-ins take, (n, N), by their name for it."""
        match name:
            case "q":
                return self.q
            case "qd":
                return self.qd
            case "qdd":
                return self.qdd
            case "tau":
                return self.torque
            case "approach":
                return self.direction
        raise ValueError(f"no quantity '{name}' in motion")

    def offsets(self, terms: tuple[JointTerm, ...], values: Array) -> Array:
        """Sum of the offsets of all terms (n, N) [rad]."""
        total = np.zeros_like(self.q)
        for term, value in zip(terms, values.tolist(), strict=True):
            if value:
                total[:, term.joint] += value * term.offset(self)
        return total


@dataclass(frozen=True, eq=False)
class Masses:
    """What loads need: the chain with a base near the truth, its bodies, and up in the tracker frame."""

    geometry: Geometry
    bodies: Bodies
    up_M: Array


def state_in_motion(path: JointPath, time_s: Array, masses: Masses | None, *, torques: bool) -> JointState:
    """State of the joints at times (n,) of the controller [s]."""
    q, qd = path.at(time_s)
    torque = np.zeros_like(q)
    if torques and masses is not None:
        torque = torques_in_motion(path, time_s, masses)
    return JointState(q, qd, path.direction_at(time_s), torque, lambda: path.acceleration_at(time_s))


def state_at_rest(q: Array, direction: Array, masses: Masses | None) -> JointState:
    """State of joints at rest after a motion in ``direction`` (n, N)."""
    torque = np.zeros_like(q)
    if masses is not None:
        torque = gravity_loads(frame_poses(masses.geometry, q), masses.bodies, masses.up_M).joint_torques()
    return JointState(q, np.zeros_like(q), direction, torque)


def torques_in_motion(path: JointPath, time_s: Array, masses: Masses) -> Array:
    """Torque of gravity and inertia of all masses about each joint axis (n, N) [Nm], positive in its direction."""
    now = gravity_loads(frame_poses(masses.geometry, path.at(time_s)[0]), masses.bodies, masses.up_M)
    before, after = (
        gravity_loads(frame_poses(masses.geometry, path.at(time_s + step)[0]), masses.bodies, masses.up_M).centers
        for step in (-_STEP_S, _STEP_S)
    )
    acceleration = (after - 2.0 * now.centers + before) / _STEP_S**2
    force = now.masses[:, :, None] * (now.gravity - acceleration)
    moment = np.cross(now.centers, force)
    force, moment = np.cumsum(force[::-1], axis=0)[::-1], np.cumsum(moment[::-1], axis=0)[::-1]
    # the last body and the payload move with the last joint: both lie beyond its axis
    force, moment = force[:-1], moment[:-1]
    about = moment - np.cross(now.origins[:-1], force)
    return np.asarray(np.einsum("jna,jna->nj", now.rotations[:-1, :, :, 2], about))
