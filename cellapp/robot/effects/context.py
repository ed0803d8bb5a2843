"""Quantities that effects depend on: conditions of each reading, and quantities derived from the arm model."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.chain import Geometry, JointAngles, frame_poses, jacobian
from cellapp.robot.kinematics.statics import Bodies, GravityLoads, gravity_loads, without_rounding
from cellapp.robot.kinematics.transforms import Array, angular_rows

# -- Columns of an effect: the SMR displacement per unit of each parameter, and what it acts on -----------


class ActsOn(Enum):
    """The part of the cell that an effect moves, and how that moves the measured SMR."""

    JOINT = "joint"
    """Offset of joint j: ``dP = offset J_j``, ``J_j = z_j x (P - o_j)``."""
    AXIS = "axis"
    """Small twist of the frame before joint j, or of joint housings."""
    LINK = "link"
    """Small twist (d, w) of D-H frame i with all beyond it: ``dP = R_i d + (R_i w) x (P - o_i)``."""
    BASE = "base"
    """Small twist of the base frame: ``dP = R_B d + (R_B w) x (P - o_B)``."""
    TOOL = "tool"
    """Shift of the SMR in the flange frame: ``dP = R_F d``."""
    TRACKER = "tracker"
    """Reading error of the tracker, along the beam or across it."""


INDEXED = frozenset({ActsOn.JOINT, ActsOn.AXIS, ActsOn.LINK})
"""What exists once per joint."""


@dataclass(frozen=True)
class Wave:
    """Cosine or sine of a multiple of a joint angle: ``cycles`` periods per turn."""

    cycles: int
    sine: bool

    def __call__(self, angle: Array) -> Array:
        """Values at joint angles [rad]."""
        return np.asarray((np.sin if self.sine else np.cos)(self.cycles * angle))


@dataclass(frozen=True)
class EffectColumn:
    """One parameter of an effect and the displacement it causes.

    Attributes
    ----------
    name : str
        For example ``compliance2``. A label for JSON and people; nothing parses it.
    unit : str
    block : str
        Columns of one block enter or leave a model together.
    lower, upper : float
        Physical bounds of the parameter; a value outside is an alias of something else, not a finding.
    acts_on : ActsOn
    index : int or None
        Joint or link, from 0; None where the column acts on all of them or what it acts on has none.
    wave : Wave or None
        Its dependence on the angle of joint ``index``, where that is periodic.
    refines : bool
        Whether it only refines other columns: without them it is not the effect.
    prior_sd : float
        Standard deviation of the parameter's zero-mean prior, where the column is part of a smooth free function;
        infinite where the parameter has no prior.
    offset : array, shape (n,), or None
        Joint offset per unit [rad]; of a joint only.
    shift_M : array, shape (n, 3), or None
        SMR shift per unit [m] in the tracker frame; of all others.
    """

    name: str
    unit: str
    block: str
    lower: float
    upper: float
    acts_on: ActsOn
    index: int | None = None
    wave: Wave | None = None
    refines: bool = False
    prior_sd: float = math.inf
    offset: Array | None = field(default=None, repr=False)
    shift_M: Array | None = field(default=None, repr=False)

    @property
    def joint(self) -> int | None:
        """The joint that it offsets, from 0; None for a column that shifts the SMR."""
        return self.index if self.acts_on is ActsOn.JOINT else None

    @property
    def cycles(self) -> int | None:
        """Periods per turn of the joint, where it is periodic."""
        return None if self.wave is None else self.wave.cycles

    @property
    def where(self) -> str:
        """What it acts on, for people: ``joint 2``, ``link 3``, ``all links``, ``base``, ``tool``, ``tracker``."""
        return place_name(self.acts_on, self.index)


def place_name(acts_on: ActsOn, index: int | None) -> str:
    """Name of what an effect acts on; ``index`` counts from 0."""
    if acts_on not in INDEXED:
        return acts_on.value
    kind = "link" if acts_on is ActsOn.LINK else "joint"
    return f"all {kind}s" if index is None else f"{kind} {index + 1}"


def joint_column(
    name: str,
    unit: str,
    joint: int,
    offset: Array,
    lower: float,
    upper: float,
    block: str | None = None,
    *,
    wave: Wave | None = None,
    refines: bool = False,
    prior_sd: float = math.inf,
) -> EffectColumn:
    """A column that offsets one joint (from 0); the default block is the joint."""
    block = block or place_name(ActsOn.JOINT, joint)
    return EffectColumn(name, unit, block, lower, upper, ActsOn.JOINT, joint, wave, refines, prior_sd, offset=offset)


def shift_column(
    name: str,
    unit: str,
    acts_on: ActsOn,
    shift_M: Array,
    lower: float,
    upper: float,
    block: str | None = None,
    *,
    index: int | None = None,
    wave: Wave | None = None,
    refines: bool = False,
) -> EffectColumn:
    """A column that shifts the SMR (n, 3) [m per unit, tracker frame]; the default block is what it acts on."""
    block = block or place_name(acts_on, index)
    return EffectColumn(name, unit, block, lower, upper, acts_on, index, wave, refines, shift_M=shift_M)


@dataclass(frozen=True)
class TemperatureRecord:
    """Temperatures over a whole run: times (m,) [s], of joints (m, N) and air (m,) [degC]."""

    time_s: Array
    joints_c: Array
    air_c: Array


@dataclass(frozen=True, kw_only=True)
class MeasurementConditions:
    """Conditions of n readings besides the joint positions; None, or NaN in a row, where unknown.

    Attributes
    ----------
    approach : array, shape (n, N)
        Sign of each joint's last motion, 0 where unknown.
    step : array, shape (n, N)
        Each joint's last motion, with its sign [rad].
    dwell_s : array, shape (n,)
        Time from rest to the measurement [s].
    time_s : array, shape (n,)
        Time since the run began [s]; NaN means "now": the state at the end of the run that the effect was fitted to.
    order : array, shape (n,)
        Rank in the order of measurement among all readings of the arm, in stops from 0; used if there are no times.
    payload_kg, air_c : arrays, shape (n,)
        Payload [kg]; temperature of arm or air [degC].
    payload_center_F : array, shape (n, 3)
        Centre of mass of the payload in the flange frame [m]; the nominal one where unknown.
    joints_c : array, shape (n, N)
        Joint temperatures [degC].
    other_moment_M : array, shape (n, 3)
        Moment of gravity on the other arm about the origin of its base, in the tracker frame [Nm].
    other_q : array, shape (n, K)
        Joint positions of the other arm [rad].
    record : TemperatureRecord
        Temperatures of the whole run, for effects that follow them with a lag; not per stop.
    R_M_S : array, shape (n, 3, 3)
        Measured orientations of a probe: at these readings the model computes the rotation vector from them [rad], at
        NaN a position [m]. A stop at which both were measured has one reading of each.
    """

    approach: Array | NDArray[np.int8] | None = None
    step: Array | None = None
    dwell_s: Array | None = None
    time_s: Array | None = None
    order: Array | None = None
    payload_kg: Array | None = None
    payload_center_F: Array | None = None
    air_c: Array | None = None
    joints_c: Array | None = None
    other_moment_M: Array | None = None
    other_q: Array | None = None
    record: TemperatureRecord | None = None
    R_M_S: Array | None = None

    @property
    def angular(self) -> NDArray[np.bool_] | None:
        """Mask (n,) of readings of an orientation; None if there are none."""
        return angular_rows(self.R_M_S)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> MeasurementConditions:
        """Select some of the stops; the temperature record stays whole."""
        taken: dict[str, Any] = {k: v[rows] for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **taken)


@dataclass(frozen=True)
class EffectContext:
    """All quantities that an effect may depend on, for n stops of one arm.

    Attributes
    ----------
    q : array, shape (n, N)
        Joint positions from the controller [rad].
    conditions : MeasurementConditions
    geometry : Geometry
        The chain, with its base in the tracker frame.
    bodies : Bodies
        Nominal masses.
    up_M : array, shape (3,)
        Unit vector against gravity in the tracker frame.
    smr_normal : array, shape (3,), or None
        SMR viewing direction in the flange frame.
    q_actual : array, shape (n, N), or None
        Joint positions after all known joint effects [rad]; loads act there. None: ``q``.
    """

    q: Array
    conditions: MeasurementConditions
    geometry: Geometry
    bodies: Bodies
    up_M: Array
    smr_normal: Array | None = None
    q_actual: Array | None = None

    @property
    def joints(self) -> int:
        """Number of joints N."""
        return int(self.q.shape[1])

    def __len__(self) -> int:
        return len(self.q)

    @property
    def posture(self) -> Array:
        """Best known joint positions (n, N) [rad]: actual where known, else as read."""
        return self.q if self.q_actual is None else self.q_actual

    @cached_property
    def approach(self) -> Array:
        """Sign of each joint's last motion (n, N), 0 where unknown."""
        approach = self.conditions.approach
        return np.zeros(self.q.shape) if approach is None else np.nan_to_num(np.asarray(approach, dtype=np.float64))

    @cached_property
    def step(self) -> Array:
        """Each joint's last motion (n, N) with its sign [rad], 0 where unknown."""
        step = self.conditions.step
        return np.zeros(self.q.shape) if step is None else np.nan_to_num(np.asarray(step, dtype=np.float64))

    @cached_property
    def payload_kg(self) -> Array:
        """Payload (n,) [kg]; the nominal one where unknown."""
        return np.asarray(self.loads.masses[-1])

    @cached_property
    def loads(self) -> GravityLoads:
        """Nominal bodies and payload in the tracker frame."""
        now = self.conditions
        return gravity_loads(self.frames, self.bodies, self.up_M, now.payload_kg, now.payload_center_F)

    @cached_property
    def torques(self) -> Array:
        """Gravity torques (n, N) of the nominal bodies with the payload [Nm]."""
        return without_rounding(self.loads.joint_torques())

    @cached_property
    def frames(self) -> tuple[Array, Array]:
        """All D-H frames, base first: rotations (N + 1, n, 3, 3), origins (N + 1, n, 3) [m] in the tracker frame."""
        return frame_poses(self.geometry, self.posture)

    @cached_property
    def p_M(self) -> Array:
        """Computed SMR positions (n, 3) [m] in the tracker frame."""
        rotations, origins = self.frames
        return np.asarray(origins[-1] + rotations[-1] @ self.geometry.tool)

    @cached_property
    def angles(self) -> JointAngles:
        """Best known joint positions for the chain, with the measured orientations."""
        return JointAngles.of(self.posture, self.conditions.R_M_S)

    @cached_property
    def angular(self) -> Array | None:
        """1 at readings (n, 1) of an orientation, 0 at those of a position; None if all are of positions."""
        angular = self.conditions.angular
        return None if angular is None else angular[:, None].astype(np.float64)

    def moved(self, shift_M: Array | None, angle_M: Array | None = None, lever_M: Array | None = None) -> Array:
        """Compute the change (n, 3) of each reading, position [m] or orientation [rad], by a small motion of a body.

        The body shifts by ``shift_M`` [m] and rotates by ``angle_M`` [rad] about a point from which ``lever_M`` (n, 3)
        [m] points to the SMR, all in the tracker frame. An orientation changes by the rotation alone.
        """
        moved = np.zeros((len(self), 3)) if shift_M is None else np.asarray(shift_M)
        if angle_M is not None and lever_M is not None:
            moved = moved + np.cross(angle_M, lever_M)
        if self.angular is None:
            return moved
        return np.asarray(moved * (1.0 - self.angular) + (0.0 if angle_M is None else angle_M * self.angular))

    @cached_property
    def base_twists(self) -> Array:
        """SMR shift per unit translation along and rotation about the base's x, y, z (6, n, 3) [m/m, m/rad]."""
        axes = np.eye(3)
        shifts = [self.twist_shift(0, axis, None) for axis in axes]
        return np.stack([*shifts, *(self.twist_shift(0, None, axis) for axis in axes)])

    @cached_property
    def link_growth(self) -> Array:
        """SMR shift per unit strain of each link, of its a and its d (N, n, 3) [m]."""
        d_and_a = tuple(6 + 5 * i + k for i in range(self.joints) for k in (1, 2))
        _, J = jacobian(self.geometry, self.angles, d_and_a)
        grown = J * self.geometry.rows[:, 1:3].ravel()[:, None]
        return np.ascontiguousarray((grown[:, 0::2] + grown[:, 1::2]).transpose(1, 2, 0))

    @cached_property
    def link_lengths(self) -> Array:
        """Distance between successive D-H origins (N,) [m]."""
        return np.hypot(self.geometry.rows[:, 1], self.geometry.rows[:, 2])

    @cached_property
    def beam(self) -> tuple[Array, Array]:
        """Range (n,) [m] and unit vector (n, 3) from the tracker to the SMR."""
        distance = np.linalg.norm(self.p_M, axis=1)
        return distance, self.p_M / distance[:, None]

    @cached_property
    def across(self) -> tuple[Array, Array, Array, Array]:
        """Azimuth, elevation (n,) [rad] and the horizontal and the upward unit vector across the beam (n, 3)."""
        x, y, z = self.p_M.T
        flat = np.hypot(x, y)
        azimuth, elevation = np.arctan2(y, x), np.arctan2(z, flat)
        zero = np.zeros_like(x)
        horizontal = np.stack([-np.sin(azimuth), np.cos(azimuth), zero], axis=1)
        s = np.sin(elevation)
        upward = np.stack([-s * np.cos(azimuth), -s * np.sin(azimuth), np.cos(elevation)], axis=1)
        return azimuth, elevation, horizontal, upward

    def twist_shift(self, frame: int, shift: Array | None, rotation: Array | None) -> Array:
        """Compute the SMR shift (n, 3) [m, tracker frame] for a small twist of D-H frame ``frame`` (0: base).

        ``shift`` [m] and ``rotation`` [rad], each (n, 3) or (3,), are in that frame. For readings of an orientation,
        the result is its change [rad].
        """
        rotations, origins = self.frames
        R, o = rotations[frame], origins[frame]
        in_M = [
            None if one is None else np.einsum("nab,nb->na", R, np.broadcast_to(one, (len(self), 3)))
            for one in (shift, rotation)
        ]
        return self.moved(in_M[0], in_M[1], self.p_M - o)


def varies(values: Array | NDArray[np.int8] | None) -> bool:
    """Return whether a quantity is known at all stops and not constant."""
    if values is None or len(values) == 0:
        return False
    known = np.asarray(values, dtype=np.float64)
    return bool(np.isfinite(known).all() and np.ptp(known, axis=0).max() > 0.0)
