"""Laws of joints in motion: offsets of a joint that follow from its path, linear in one parameter each.

    play       dq_j = -h_j d_j            d the direction with history (play operator): backlash
    wind-up    dq_j = -w_j d_j |tau_j|    friction that grows with the load
    fading     dq_j = -f_j e_j, -f_j e_j |tau_j|   beside both, what changes over the travel x since the joint turned
                                          round: e = c exp(-x / reach), c by its history, or a bell (``joint_path``)
    line       dq_j = a cos(c q_j) + b sin(c q_j)   transmission error, c cycles a turn; lines of c - 1 and c + 1 beside
                                          it where the amplitude changes with the joint or c is not whole
    one cycle  the same of one cycle a turn: encoder eccentricity, at all joints together
    lag        dq_j = -T_j qd_j           delay of one joint's position behind the others'
    compliance dq_j = k_j tau_j           tau = gravity + inertia: torque of all masses beyond, at their acceleration
    knee       dq_j = s_j clip(tau_j, -T_j, T_j)   beside it, where a joint is softer below one or two torques T_j
    inertia    dq_j = -i_j qdd_j          twist under the joint's own acceleration, which needs no masses
    time constant  dq_j = x_j(T_j) - q_j  a first-order lag (``responses``)
    vibration  dq_j = g_j (y_j(f_j, d_j) + qdd_j)   what a damped spring adds after changes of acceleration

The torque of inertia is that of point masses (``statics``): ``tau_j = z_j . sum_k (c_k - o_j) x m_k (g - a_k)``. Lags
and the last three serve motion only, as do laws of speeds of plug-ins; the others serve commands at rest as well. What
only motion can show: these, the part of inertia in a compliance, and lines that are denser than stops can sample. Time
constants, frequencies and dampings are not linear: their terms are those at a shape, about which a fit is repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.motion.joint_path import BEND_S, Fading, JointPath
from cellapp.robot.effects import MotionLaw
from cellapp.robot.effects.backlash import left_by_motion
from cellapp.robot.effects.joint_compliance import KNEE, SOFTER
from cellapp.robot.effects.law import Constant
from cellapp.robot.kinematics.chain import Geometry, frame_poses
from cellapp.robot.kinematics.interpolation import rows_at
from cellapp.robot.kinematics.statics import Bodies, gravity_loads
from cellapp.robot.kinematics.transforms import Array

CHUNK = 2048
"""Times of a recording that are computed at once: memory does not grow with their number."""
_OWN_INERTIA = 0.02
"""Of a joint's own link about its axis [kg m^2], which point masses on the axis do not have."""


class Law(Enum):
    """A law of one joint; the value is the slug of the effect that it belongs to."""

    PLAY = "backlash"
    WINDUP = "friction_windup"
    LINE = "transmission_error"
    ONE_CYCLE = "encoder_eccentricity"
    LAG = "tracking_lag"
    COMPLIANCE = "joint_compliance"
    INERTIA = "inertia"
    TIME_CONSTANT = "time_constant"
    VIBRATION = "vibration"


_UNIT = {
    Law.PLAY: "rad",
    Law.WINDUP: "rad/Nm",
    Law.LINE: "rad",
    Law.ONE_CYCLE: "rad",
    Law.LAG: "s",
    Law.COMPLIANCE: "rad/Nm",
    Law.INERTIA: "s^2",
    Law.TIME_CONSTANT: "s",
}
_SD = {
    Law.PLAY: 1e-4,
    Law.WINDUP: 1e-5,
    Law.LINE: 3e-4,
    Law.ONE_CYCLE: 3e-4,
    Law.LAG: 5e-3,
    Law.COMPLIANCE: 2e-5,
    Law.INERTIA: 1e-3,
    Law.TIME_CONSTANT: 3e-2,
}
"""Prior standard deviations, several times what arms of this kind have (handbook, chapter "effects")."""
_SIDE_SD = 3e-5
"""The same of what modulates a line: part of its amplitude [rad]."""
_VIBRATION = (("gain", "s^2"), ("frequency", "Hz"), ("damping", "1"))
"""Parameters of a vibration with their units: deflection by acceleration, natural frequency, share of the critical
damping."""
_GAIN_SD, _SHAPE_SD = 1e-3, 0.5
"""Prior standard deviations: of a gain [s^2], that of a spring at 5 Hz; of frequency and damping, relative."""


def of_all_joints(law: Law | MotionLaw, joints: int) -> tuple[JointTerm, ...]:
    """The parameters of a law that has some at every joint, but for lines and shaped ones."""
    names = tuple(law.parameters) if isinstance(law, MotionLaw) else ("",)
    if law is Law.ONE_CYCLE:
        return tuple(JointTerm(law, joint, 1, sine) for joint in range(joints) for sine in (False, True))
    return tuple(JointTerm(law, joint, parameter=name) for joint in range(joints) for name in names)


@dataclass(frozen=True)
class Knee:
    """Torque [Nm] below which a joint is softer, and the constant of the law at rest that it is: one of ``SOFTER``."""

    torque: float
    constant: Constant = KNEE


@dataclass(frozen=True)
class JointTerm:
    """One parameter of a law: of joint ``joint`` (from 0); ``cycles`` a turn and ``sine`` for lines; ``shape`` about
    which a time constant [s], or gain [s^2], frequency [Hz] and damping of a vibration lie, of which it is number
    ``part``."""

    law: Law | MotionLaw
    joint: int
    cycles: int = 0
    sine: bool = False
    shape: tuple[float, ...] = ()
    part: int = 0
    parameter: str = ""
    """Its name in a law of a plug-in."""
    fading: Fading | None = None
    """Of a part of play or wind-up that fades with the travel since the joint turned round."""
    knee: Knee | None = None
    """Of a part of a compliance."""
    side: int = 0
    """-1 or 1 of a line of the count below or above that of another line, whose amplitude changes with the joint."""

    @property
    def refines(self) -> bool:
        """Whether it is a part beside the plain law of its joint."""
        return self.fading is not None or self.knee is not None or self.side != 0

    @property
    def place(self) -> tuple[int, int]:
        """Joint, and cycles a turn of the line that it is or belongs to: terms of one place show a law together."""
        return self.joint, self.cycles - self.side

    @property
    def name(self) -> str:
        """Name of the parameter, as the effects name theirs."""
        number = self.joint + 1
        if isinstance(self.law, MotionLaw):
            return f"{self.parameter}{number}"
        fresh = "fresh_" if self.fading else ""
        line = f"{'sin' if self.sine else 'cos'}{self.cycles}q{number}"
        return {
            Law.PLAY: f"{fresh}half_play{number}",
            Law.WINDUP: f"{fresh}windup{number}",
            Law.LINE: line,
            Law.ONE_CYCLE: line,
            Law.LAG: f"lag{number}",
            Law.COMPLIANCE: f"{'compliance' if self.knee is None else SOFTER[self.knee.constant]}{number}",
            Law.INERTIA: f"inertia{number}",
            Law.TIME_CONSTANT: f"time_constant{number}",
            Law.VIBRATION: f"{_VIBRATION[self.part][0]}{number}",
        }[self.law]

    @property
    def unit(self) -> str:
        """Unit of the parameter."""
        if isinstance(self.law, MotionLaw):
            return self.law.parameters[self.parameter].unit
        return _VIBRATION[self.part][1] if self.law is Law.VIBRATION else _UNIT[self.law]

    @property
    def start(self) -> float:
        """Value at which a fit begins."""
        return self.shape[self.part] if self.shape else 0.0

    @property
    def prior_mean(self) -> float:
        """Centre of its prior: the shape of a frequency or a damping, no effect of all others."""
        return self.start if self.part else 0.0

    @property
    def prior_sd(self) -> float:
        """Standard deviation of its prior."""
        if isinstance(self.law, MotionLaw):
            return self.law.parameters[self.parameter].most
        if self.law is Law.VIBRATION:
            return _SHAPE_SD * self.start if self.part else _GAIN_SD
        return _SIDE_SD if self.side else _SD[self.law]

    @property
    def needs_torques(self) -> bool:
        """Whether it depends on torques."""
        return self.law.needs_torques if isinstance(self.law, MotionLaw) else self.law in (Law.WINDUP, Law.COMPLIANCE)

    def offset(self, state: JointState) -> Array:
        """Offset of the joint (n,) per unit of the parameter [rad]."""
        j = self.joint
        if isinstance(self.law, MotionLaw):
            return self.law.offset(self.parameter, j, state.quantity)
        if self.law in (Law.PLAY, Law.WINDUP):
            side = state.direction[:, j] if self.fading is None else state.left(j, self.fading)
            return np.asarray(-side * np.abs(state.torque[:, j]) if self.law is Law.WINDUP else -side)
        if self.law is Law.LAG:
            return np.asarray(-state.qd[:, j])
        if self.law is Law.INERTIA:
            return np.asarray(-state.qdd[:, j])
        if self.law in (Law.TIME_CONSTANT, Law.VIBRATION):
            return self._of_course(state)
        if self.law in (Law.LINE, Law.ONE_CYCLE):
            return np.asarray((np.sin if self.sine else np.cos)(self.cycles * state.q[:, j]))
        torque = state.torque[:, j]
        return np.asarray(torque if self.knee is None else np.clip(torque, -self.knee.torque, self.knee.torque))

    def turned(self, state: JointState, value: float, unit: Array) -> Array:
        """Offset of the joint (n,) for a value of the parameter [rad], ``unit`` (n,) being its ``offset``; of shaped
        terms, with what the shape gives."""
        if self.law is Law.TIME_CONSTANT and state.course is not None:
            path, time_s = state.course
            at_shape = path.even.at(path.even.lagging(self.joint, self.shape[0])[0], time_s)
            return np.asarray(at_shape + (value - self.shape[0]) * unit)
        if self.law is Law.VIBRATION and self.part:
            value -= self.shape[self.part]
        return np.asarray(value * unit)

    def _of_course(self, state: JointState) -> Array:
        """The same of laws that depend on the whole course of a motion."""
        if state.course is None:
            return np.zeros(len(state.q))
        (path, time_s), j = state.course, self.joint
        if self.law is Law.TIME_CONSTANT:
            return path.even.at(path.even.lagging(j, self.shape[0])[1], time_s)
        gain, frequency, damping = self.shape
        answer = path.even.at(path.even.of_shape(j, frequency, damping, self.part), time_s)
        return gain * answer if self.part else answer


@dataclass(frozen=True, eq=False)
class JointState:
    """Joint positions, speeds, directions with history and torques of all masses [Nm], each (n, N); in motion the path
    and the times (n,) on it; at rest the last motions (n, N) [rad], where they are known."""

    q: Array
    qd: Array
    direction: Array
    torque: Array
    course: tuple[JointPath, Array] | None = None
    step: Array | None = None

    def left(self, joint: int, fading: Fading) -> Array:
        """What a joint has not taken up yet of its lost motion (n,), against its direction; at rest as if it had come
        from the middle, as what it had taken up before its last motion is not known."""
        if self.course is not None:
            return self.course[0].fading_at(self._samples, self.q[:, joint], joint, fading)
        if self.step is None:
            return np.zeros(len(self.q))
        return np.asarray(
            self.direction[:, joint] * left_by_motion(self.step[:, joint], fading.reach, bell=fading.bell)
        )

    @cached_property
    def _samples(self) -> NDArray[np.intp]:
        """The last samples (n,) of the path."""
        assert self.course is not None
        path, time_s = self.course
        return path.samples_at(time_s)

    @cached_property
    def qdd(self) -> Array:
        """Accelerations (n, N) [rad/s^2]; zero at rest."""
        if self.course is None:
            return np.zeros_like(self.q)
        path, time_s = self.course
        return rows_at(time_s, path.even.time_s, path.even.qdd)

    def quantity(self, name: str) -> Array:
        """What laws of plug-ins take, (n, N), by their name for it."""
        if name == "qdd":
            return self.qdd
        return {"q": self.q, "qd": self.qd, "tau": self.torque, "approach": self.direction}[name]

    def offsets(self, terms: tuple[JointTerm, ...], values: Array, units: Sequence[Array] | None = None) -> Array:
        """Sum of the offsets of all terms (n, N) [rad]; ``units`` are their offsets per unit, where they are known."""
        total = np.zeros_like(self.q)
        for number, (term, value) in enumerate(zip(terms, values.tolist(), strict=True)):
            if value:
                unit = term.offset(self) if units is None else units[number]
                total[:, term.joint] += term.turned(self, value, unit)
        return total


@dataclass(frozen=True, eq=False)
class Masses:
    """What loads need: the chain with a base near the truth, its bodies, and up in the tracker frame."""

    geometry: Geometry
    bodies: Bodies
    up_M: Array

    def matrix(self, q: Array) -> Array:
        """Mass matrix (n, N, N) [kg m^2] of point masses at ``q`` (n, N): ``sum_k m_k (z_i x r_ik) . (z_j x r_jk)``
        over the masses beyond both joints."""
        loads, joints = gravity_loads(frame_poses(self.geometry, q), self.bodies, self.up_M), q.shape[1]
        levers = loads.centers[None] - loads.origins[:-1, None]
        moved = np.cross(loads.rotations[:-1, None, :, :, 2], levers)  # (joint, mass, n, 3)
        moved[np.arange(joints)[:, None] > np.arange(joints + 1)[None]] = 0.0
        return np.asarray(np.einsum("iknx,jknx,kn->nij", moved, moved, loads.masses) + _OWN_INERTIA * np.eye(joints))


def state_in_motion(path: JointPath, time_s: Array, masses: Masses | None, *, torques: bool) -> JointState:
    """State of the joints at times (n,) of the controller [s]."""
    q, qd = path.at(time_s)
    torque = np.zeros_like(q)
    if torques and masses is not None:
        even = path.even
        on_grid = even.kept((torques_in_motion, masses), partial(_in_chunks, path, even.inside_s, masses))
        torque = rows_at(time_s, even.time_s, on_grid)
    return JointState(q, qd, path.direction_at(time_s), torque, (path, time_s))


def _in_chunks(path: JointPath, time_s: Array, masses: Masses) -> Array:
    """``torques_in_motion`` at many times."""
    parts = np.array_split(time_s, -(-len(time_s) // CHUNK))
    return np.concatenate([torques_in_motion(path, part, masses) for part in parts])


def state_at_rest(q: Array, direction: Array, masses: Masses | None, step: Array | None = None) -> JointState:
    """State of joints at rest after a motion in ``direction`` (n, N), by ``step`` (n, N) [rad], where that is known."""
    torque = np.zeros_like(q)
    if masses is not None:
        torque = gravity_loads(frame_poses(masses.geometry, q), masses.bodies, masses.up_M).joint_torques()
    return JointState(q, np.zeros_like(q), direction, torque, step=step)


def torques_in_motion(path: JointPath, time_s: Array, masses: Masses) -> Array:
    """Torque of gravity and inertia of all masses about each joint axis (n, N) [Nm], positive in its direction."""
    now = gravity_loads(frame_poses(masses.geometry, path.at(time_s)[0]), masses.bodies, masses.up_M)
    before, after = (
        gravity_loads(frame_poses(masses.geometry, path.at(time_s + step)[0]), masses.bodies, masses.up_M).centers
        for step in (-BEND_S, BEND_S)
    )
    acceleration = (after - 2.0 * now.centers + before) / BEND_S**2
    force = now.masses[:, :, None] * (now.gravity - acceleration)
    moment = np.cross(now.centers, force)
    force, moment = np.cumsum(force[::-1], axis=0)[::-1], np.cumsum(moment[::-1], axis=0)[::-1]
    # the last body and the payload move with the last joint: both lie beyond its axis
    force, moment = force[:-1], moment[:-1]
    about = moment - np.cross(now.origins[:-1], force)
    return np.asarray(np.einsum("jna,jna->nj", now.rotations[:-1, :, :, 2], about))


@dataclass(frozen=True, eq=False)
class JointLaws:
    """Laws of an arm's joints, each with its value: those that act at rest, and those of motion only."""

    at_rest: tuple[tuple[JointTerm, float], ...]
    moving: tuple[tuple[JointTerm, float], ...]
    masses: Masses | None

    def joints_at_rest(self, path: JointPath, time_s: Array) -> Array:
        """Joint positions (n, N) [rad] at which an arm at rest has the points of these times (n,) [s]: without what
        only motion has."""
        state = state_in_motion(path, time_s, None, torques=False)
        return state.q + state.offsets(*_apart(self.moving))

    def joints_with_history(self, path: JointPath, time_s: Array) -> Array:
        """The same with what the laws at rest have in motion beyond rest, where they know the last motion of each
        joint only: what the turns before it left, and the torque of accelerations."""
        terms, values = _apart(self.at_rest)
        torques = any(term.needs_torques for term in terms)
        q = self.joints_at_rest(path, time_s)
        moves = state_in_motion(path, time_s, self.masses, torques=torques)
        side, travel = np.sign(np.rint(moves.direction)), path.travel_at(time_s, moves.q)
        rests = state_at_rest(q, side, self.masses if torques else None, travel)
        return q + moves.offsets(terms, values) - rests.offsets(terms, values)


def _apart(pairs: tuple[tuple[JointTerm, float], ...]) -> tuple[tuple[JointTerm, ...], Array]:
    return tuple(term for term, _ in pairs), np.array([value for _, value in pairs])
