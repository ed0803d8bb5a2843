"""Laws of joints in motion: joint offsets that depend on the path, each linear in one parameter.

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
    time constant  dq_j = x_j(T_j) - q_j  a first-order lag (``joint_path``)
    vibration  dq_j = g_j (y_j(f_j, d_j) + qdd_j)   what a damped spring adds after changes of acceleration

The torque of inertia is that of point masses (``statics``): ``tau_j = z_j . sum_k (c_k - o_j) x m_k (g - a_k)``. Lags,
the last three laws, and laws of plug-ins that depend on speeds serve motion only; the others serve commands at rest as
well. Only motion can show these, the part of inertia in a compliance, and lines that are denser than stops can sample.
Time constants, frequencies and dampings are not linear: their terms are linearised at a shape, and the fit is repeated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from cellapp.robot.kinematics.statics import Bodies, gravity_loads
from cellapp.robot.kinematics.transforms import Array, rows_at

CHUNK = 2048
"""Batch size of times of a recording: memory does not grow with their number."""
_OWN_INERTIA = 0.02
"""Inertia of a joint's own link about its axis [kg m^2], which point masses on the axis lack."""


class Law(Enum):
    """Law of one joint; the value is the slug of its effect."""

    PLAY = "backlash"
    WINDUP = "friction_windup"
    LINE = "transmission_error"
    ONE_CYCLE = "encoder_eccentricity"
    LAG = "tracking_lag"
    COMPLIANCE = "joint_compliance"
    INERTIA = "inertia"
    TIME_CONSTANT = "time_constant"
    VIBRATION = "vibration"


_OF_LAW: Mapping[Law, tuple[str, str, float]] = {
    Law.PLAY: ("half_play", "rad", 1e-4),
    Law.WINDUP: ("windup", "rad/Nm", 1e-5),
    Law.LINE: ("", "rad", 3e-4),
    Law.ONE_CYCLE: ("", "rad", 3e-4),
    Law.LAG: ("lag", "s", 5e-3),
    Law.COMPLIANCE: ("compliance", "rad/Nm", 2e-5),
    Law.INERTIA: ("inertia", "s^2", 1e-3),
    Law.TIME_CONSTANT: ("time_constant", "s", 3e-2),
}
"""Name and unit of the parameter of a law, and its prior standard deviation, several times the values of arms of this
kind (handbook, chapter "effects"); lines are named by their cycles."""
_SIDE_SD = 3e-5
"""Prior standard deviation of the modulation of a line: part of its amplitude [rad]."""
_VIBRATION = (("gain", "s^2"), ("frequency", "Hz"), ("damping", "1"))
"""Parameters of a vibration with their units: deflection per acceleration, natural frequency, damping ratio."""
_GAIN_SD, _SHAPE_SD = 1e-3, 0.5
"""Prior standard deviations: of a gain [s^2], that of a spring at 5 Hz; relative ones of frequency and damping."""


def of_all_joints(law: Law | MotionLaw, joints: int) -> tuple[JointTerm, ...]:
    """Return the parameters of a law at all joints, except for lines and shaped laws."""
    names = tuple(law.parameters) if isinstance(law, MotionLaw) else ("",)
    if law is Law.ONE_CYCLE:
        return tuple(JointTerm(law, joint, 1, sine) for joint in range(joints) for sine in (False, True))
    return tuple(JointTerm(law, joint, parameter=name) for joint in range(joints) for name in names)


@dataclass(frozen=True)
class Knee:
    """Torque [Nm] below which a joint is softer, and the constant of the law at rest, one of ``SOFTER``."""

    torque: float
    constant: Constant = KNEE


@dataclass(frozen=True)
class JointTerm:
    """One parameter of a law: of joint ``joint`` (from 0); ``cycles`` a turn and ``sine`` for lines. ``shape`` is the
    point of linearisation: a time constant [s], or gain [s^2], frequency [Hz] and damping ratio of a vibration.
    ``part`` is the index of the parameter in it."""

    law: Law | MotionLaw
    joint: int
    cycles: int = 0
    sine: bool = False
    shape: tuple[float, ...] = ()
    part: int = 0
    parameter: str = ""
    """Name of the parameter in a law of a plug-in."""
    fading: Fading | None = None
    """Set for a part of play or wind-up that fades with the travel since the joint reversed."""
    knee: Knee | None = None
    """Set for a part of a compliance."""
    side: int = 0
    """-1 or 1 for a line at the count below or above another line, whose amplitude changes with the joint."""

    @property
    def refines(self) -> bool:
        """Whether it is a refining part beside the plain law of its joint."""
        return self.fading is not None or self.knee is not None or self.side != 0

    @property
    def place(self) -> tuple[int, int]:
        """Joint, and cycles a turn of the line that it is or belongs to: terms with the same place form one law."""
        return self.joint, self.cycles - self.side

    @property
    def name(self) -> str:
        """Name of the parameter, as in the library of effects."""
        number = self.joint + 1
        if isinstance(self.law, MotionLaw):
            return f"{self.parameter}{number}"
        if self.law in (Law.LINE, Law.ONE_CYCLE):
            return f"{'sin' if self.sine else 'cos'}{self.cycles}q{number}"
        if self.law is Law.VIBRATION:
            return f"{_VIBRATION[self.part][0]}{number}"
        word = _OF_LAW[self.law][0] if self.knee is None else SOFTER[self.knee.constant]
        return f"{'fresh_' if self.fading else ''}{word}{number}"

    @property
    def unit(self) -> str:
        """Unit of the parameter."""
        if isinstance(self.law, MotionLaw):
            return self.law.parameters[self.parameter].unit
        return _VIBRATION[self.part][1] if self.law is Law.VIBRATION else _OF_LAW[self.law][1]

    @property
    def start(self) -> float:
        """Start value of a fit."""
        return self.shape[self.part] if self.shape else 0.0

    @property
    def prior_mean(self) -> float:
        """Mean of its prior: the shape for a frequency or a damping, zero for all others."""
        return self.start if self.part else 0.0

    @property
    def prior_sd(self) -> float:
        """Standard deviation of its prior."""
        if isinstance(self.law, MotionLaw):
            return self.law.parameters[self.parameter].most
        if self.law is Law.VIBRATION:
            return _SHAPE_SD * self.start if self.part else _GAIN_SD
        return _SIDE_SD if self.side else _OF_LAW[self.law][2]

    @property
    def needs_torques(self) -> bool:
        """Whether it depends on torques."""
        return self.law.needs_torques if isinstance(self.law, MotionLaw) else self.law in (Law.WINDUP, Law.COMPLIANCE)

    def offset(self, state: JointState) -> Array:
        """Return the offset of the joint (n,) per unit of the parameter [rad]."""
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
        """Return the offset of the joint (n,) for a value of the parameter [rad], where ``unit`` (n,) is its
        ``offset``; for shaped terms including the offset at the shape."""
        if self.law is Law.TIME_CONSTANT and state.course is not None:
            path, time_s = state.course
            at_shape = path.even.at(path.even.lagging(self.joint, self.shape[0])[0], time_s)
            return np.asarray(at_shape + (value - self.shape[0]) * unit)
        if self.law is Law.VIBRATION and self.part:
            value -= self.shape[self.part]
        return np.asarray(value * unit)

    def _of_course(self, state: JointState) -> Array:
        """Return ``offset`` for laws that depend on the whole course of a motion."""
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
    """Joint positions, speeds, directions with history and torques of all masses [Nm], each (n, N). In motion also the
    path and the times (n,) on it; at rest the last motions (n, N) [rad] if known."""

    q: Array
    qd: Array
    direction: Array
    torque: Array
    course: tuple[JointPath, Array] | None = None
    step: Array | None = None

    def left(self, joint: int, fading: Fading) -> Array:
        """Return the lost motion (n,) that a joint has not yet taken up, against its direction. At rest it is computed
        as if starting from the middle, as the state before the last motion is unknown."""
        if self.course is not None:
            return self.course[0].fading_at(self._samples, self.q[:, joint], joint, fading)
        if self.step is None:
            return np.zeros(len(self.q))
        return np.asarray(
            self.direction[:, joint] * left_by_motion(self.step[:, joint], fading.reach, bell=fading.bell)
        )

    @cached_property
    def _samples(self) -> NDArray[np.intp]:
        """Indices (n,) of the last samples of the path."""
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
        """Return a quantity (n, N) for laws of plug-ins, by its name there."""
        if name == "qdd":
            return self.qdd
        return {"q": self.q, "qd": self.qd, "tau": self.torque, "approach": self.direction}[name]

    def offsets(self, terms: tuple[JointTerm, ...], values: Array, units: Sequence[Array] | None = None) -> Array:
        """Return the sum of the offsets of all terms (n, N) [rad]; ``units`` are their offsets per unit, if known."""
        total = np.zeros_like(self.q)
        for number, (term, value) in enumerate(zip(terms, values.tolist(), strict=True)):
            if value:
                unit = term.offset(self) if units is None else units[number]
                total[:, term.joint] += term.turned(self, value, unit)
        return total


@dataclass(frozen=True, eq=False)
class Masses:
    """Data for loads: the chain with an approximate base, its bodies, and up in the tracker frame."""

    geometry: Geometry
    bodies: Bodies
    up_M: Array

    def matrix(self, q: Array) -> Array:
        """Return the mass matrix (n, N, N) [kg m^2] of point masses at ``q`` (n, N): ``sum_k m_k (z_i x r_ik) . (z_j x
        r_jk)`` over the masses beyond both joints."""
        loads, joints = gravity_loads(frame_poses(self.geometry, q), self.bodies, self.up_M), q.shape[1]
        levers = loads.centers[None] - loads.origins[:-1, None]
        moved = np.cross(loads.rotations[:-1, None, :, :, 2], levers)  # (joint, mass, n, 3)
        moved[np.arange(joints)[:, None] > np.arange(joints + 1)[None]] = 0.0
        return np.asarray(np.einsum("iknx,jknx,kn->nij", moved, moved, loads.masses) + _OWN_INERTIA * np.eye(joints))


def state_in_motion(path: JointPath, time_s: Array, masses: Masses | None, *, torques: bool) -> JointState:
    """Return the state of the joints at times (n,) of the controller [s]."""
    q, qd = path.at(time_s)
    torque = np.zeros_like(q)
    if torques and masses is not None:
        even = path.even
        on_grid = even.kept((torques_in_motion, masses), partial(_in_chunks, path, even.inside_s, masses))
        torque = rows_at(time_s, even.time_s, on_grid)
    return JointState(q, qd, path.direction_at(time_s), torque, (path, time_s))


def _in_chunks(path: JointPath, time_s: Array, masses: Masses) -> Array:
    """Compute ``torques_in_motion`` at many times, in chunks."""
    parts = np.array_split(time_s, -(-len(time_s) // CHUNK))
    return np.concatenate([torques_in_motion(path, part, masses) for part in parts])


def state_at_rest(q: Array, direction: Array, masses: Masses | None, step: Array | None = None) -> JointState:
    """Return the state of joints at rest after a motion in ``direction`` (n, N), by ``step`` (n, N) [rad] if known."""
    torque = np.zeros_like(q)
    if masses is not None:
        torque = gravity_loads(frame_poses(masses.geometry, q), masses.bodies, masses.up_M).joint_torques()
    return JointState(q, np.zeros_like(q), direction, torque, step=step)


def torques_in_motion(path: JointPath, time_s: Array, masses: Masses) -> Array:
    """Return the torque of gravity and inertia of all masses about each joint axis (n, N) [Nm], positive along it."""
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
    """Laws of an arm's joints with their values: those that act at rest, and those of motion only."""

    at_rest: tuple[tuple[JointTerm, float], ...]
    moving: tuple[tuple[JointTerm, float], ...]
    masses: Masses | None

    def joints_at_rest(self, path: JointPath, time_s: Array) -> Array:
        """Return the joint positions (n, N) [rad] at which an arm at rest has the points of these times (n,) [s]:
        without the laws of motion only."""
        state = state_in_motion(path, time_s, None, torques=False)
        return state.q + state.offsets(*_apart(self.moving))

    def joints_with_history(self, path: JointPath, time_s: Array) -> Array:
        """Return ``joints_at_rest`` plus the part of the laws at rest that motion adds: lost motion from earlier
        reversals, and the torque of accelerations. At rest, only the last motion of each joint is known."""
        terms, values = _apart(self.at_rest)
        torques = any(term.needs_torques for term in terms)
        q = self.joints_at_rest(path, time_s)
        moves = state_in_motion(path, time_s, self.masses, torques=torques)
        side, travel = np.sign(np.rint(moves.direction)), path.travel_at(time_s, moves.q)
        rests = state_at_rest(q, side, self.masses if torques else None, travel)
        return q + moves.offsets(terms, values) - rests.offsets(terms, values)


def _apart(pairs: tuple[tuple[JointTerm, float], ...]) -> tuple[tuple[JointTerm, ...], Array]:
    return tuple(term for term, _ in pairs), np.array([value for _, value in pairs])
