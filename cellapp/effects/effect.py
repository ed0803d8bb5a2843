"""What an effect is: laws, columns that are linear in its parameters, and what a person must know of it.

An effect acts through one or more channels, each of which moves the measured SMR:

    joint     the joint stands at q_j + beta D(stop):      dP = beta D J_j,  J_j = z_j x (P - o_j)
    base      the base moves by a small twist (d, w) in B: dP = R_B d + (R_B w) x (P - o_B)
    link      so does D-H frame i with all beyond it:      dP = R_i d + (R_i w) x (P - o_i)
    tool      the SMR moves in the flange:                 dP = R_F d
    tracker   the tracker misreads:                        dP along the beam or across it

Joint offsets enter the chain exactly; the other channels move the SMR by less than a millimetre and enter linearly.

A *law* is one way in which an effect may depend on the circumstances, with its constants (a time constant, an onset).
Its *columns* are what each parameter does; columns of one *block* stand or fall together.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cellapp.kinematics.chain import Geometry, JointAngles, frame_poses, jacobian, joint_jacobian
from cellapp.kinematics.statics import Bodies, gravity_torques
from cellapp.kinematics.transforms import Array


@dataclass(frozen=True)
class Record:
    """Temperatures of a run: times (m,) [s], of joints (m, N) and air (m,) [degC]."""

    time_s: Array
    joints_c: Array
    air_c: Array


@dataclass(frozen=True, kw_only=True)
class Circumstances:
    """What is known of n stops beside the joint positions; None, or NaN in a row, where nobody knows.

    Attributes
    ----------
    approach : array, shape (n, N)
        Sign of each joint's last motion, 0 where unknown.
    step : array, shape (n, N)
        Each joint's last motion, with its sign [rad].
    dwell_s : array, shape (n,)
        From rest to the measurement [s].
    time_s : array, shape (n,)
        Since the run began [s]; NaN is "now": as it was at the end of the run that taught the effect.
    payload_kg, air_c : arrays, shape (n,)
        Payload [kg]; temperature of arm or air [degC].
    joints_c : array, shape (n, N)
        Joint temperatures [degC].
    other_moment_M : array, shape (n, 3)
        Moment of gravity on the other arm about the origin of its base, in the tracker frame [Nm].
    other_q : array, shape (n, K)
        Joint positions of the other arm [rad].
    record : Record
        Temperatures of the whole run, which what follows them slowly needs; not one a stop.
    """

    approach: Array | NDArray[np.int8] | None = None
    step: Array | None = None
    dwell_s: Array | None = None
    time_s: Array | None = None
    payload_kg: Array | None = None
    air_c: Array | None = None
    joints_c: Array | None = None
    other_moment_M: Array | None = None
    other_q: Array | None = None
    record: Record | None = None

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Circumstances:
        """Those of some stops; the record stays whole."""
        taken: dict[str, Any] = {k: v[rows] for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **taken)


@dataclass(frozen=True)
class EffectContext:
    """All that an effect may depend on, for n stops of one arm.

    Attributes
    ----------
    q : array, shape (n, N)
        Joint positions from the controller [rad].
    known : Circumstances
    geometry : Geometry
        The chain, standing in the tracker frame.
    bodies : Bodies
        Nominal masses.
    up_M : array, shape (3,)
        Unit vector against gravity in the tracker frame.
    smr_normal : array, shape (3,), or None
        The way the SMR looks, in the flange frame.
    stands : array, shape (n, N), or None
        Where the joints really stand [rad], as far as known; loads act there. None is at ``q``.
    """

    q: Array
    known: Circumstances
    geometry: Geometry
    bodies: Bodies
    up_M: Array
    smr_normal: Array | None = None
    stands: Array | None = None

    @property
    def joints(self) -> int:
        """Number of joints N."""
        return int(self.q.shape[1])

    def __len__(self) -> int:
        return len(self.q)

    @property
    def posture(self) -> Array:
        """Where the joints really stand (n, N) [rad], as far as known."""
        return self.q if self.stands is None else self.stands

    @cached_property
    def approach(self) -> Array:
        """Sign of each joint's last motion (n, N), 0 where unknown."""
        known = self.known.approach
        return np.zeros(self.q.shape) if known is None else np.nan_to_num(np.asarray(known, dtype=np.float64))

    @cached_property
    def step(self) -> Array:
        """Each joint's last motion (n, N) with its sign [rad], 0 where unknown."""
        known = self.known.step
        return np.zeros(self.q.shape) if known is None else np.nan_to_num(np.asarray(known, dtype=np.float64))

    @cached_property
    def payload_kg(self) -> Array:
        """Payload (n,) [kg]; the nominal one where unknown."""
        known = self.known.payload_kg
        nominal = np.full(len(self), self.bodies.payload_mass)
        return nominal if known is None else np.where(np.isnan(known), nominal, known)

    @cached_property
    def torques(self) -> Array:
        """Gravity torques (n, N) of the nominal bodies with the payload [Nm]."""
        return gravity_torques(self.geometry, self.bodies, self.posture, self.up_M, self.payload_kg)

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
    def joint_jacobian(self) -> Array:
        """Derivatives of the SMR position by the joints (3, N, n) [m/rad] in the tracker frame."""
        return joint_jacobian(self.geometry, JointAngles.of(self.posture))[1]

    @cached_property
    def base_twists(self) -> Array:
        """What the base's shifts along and turns about its x, y, z do to the SMR (6, n, 3) [m per m, m per rad]."""
        axes = np.eye(3)
        shifts = [self.twist_shift(0, axis, None) for axis in axes]
        return np.stack([*shifts, *(self.twist_shift(0, None, axis) for axis in axes)])

    @cached_property
    def link_growth(self) -> Array:
        """What a unit strain of each link, of its a and its d, does to the SMR (N, n, 3) [m]."""
        d_and_a = tuple(6 + 5 * i + k for i in range(self.joints) for k in (1, 2))
        _, J = jacobian(self.geometry, JointAngles.of(self.posture), d_and_a)
        grown = J * self.geometry.rows[:, 1:3].ravel()[:, None]
        return np.ascontiguousarray((grown[:, 0::2] + grown[:, 1::2]).transpose(1, 2, 0))

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

    def twist_shift(self, frame: int, shift: Array | None, turn: Array | None) -> Array:
        """What a small twist of D-H frame ``frame`` (0 base) does to the SMR, (n, 3) [m] in the tracker frame.

        ``shift`` [m] and ``turn`` [rad], each (n, 3) or (3,), are in that frame.
        """
        rotations, origins = self.frames
        R, o = rotations[frame], origins[frame]
        moved = np.zeros((len(self), 3))
        if shift is not None:
            moved += np.einsum("nab,nb->na", R, np.broadcast_to(shift, moved.shape))
        if turn is not None:
            moved += np.cross(np.einsum("nab,nb->na", R, np.broadcast_to(turn, moved.shape)), self.p_M - o)
        return moved

    def load_beyond(self, frame: int) -> tuple[Array, Array]:
        """Weight [N] and its moment about the origin of D-H frame ``frame`` [Nm] of all bodies beyond it.

        Both (n, 3) in the tracker frame; beyond frame i are the bodies i + 1 to N and the payload.
        """
        rotations, origins = self.frames
        masses = self.bodies.masses
        weight_direction = -9.80665 * self.up_M
        total = self.payload_kg[:, None].copy()
        moment = self.payload_kg[:, None] * (origins[-1] + rotations[-1] @ self.bodies.payload_center)
        for body in range(frame, len(masses)):
            center = origins[body + 1] + rotations[body + 1] @ self.bodies.centers[body]
            moment = moment + masses[body] * center
            total = total + masses[body]
        lever = moment - total * origins[frame]
        return np.asarray(total * weight_direction), np.cross(lever, weight_direction)


@dataclass(frozen=True)
class EffectColumn:
    """One parameter of an effect and what it does.

    Attributes
    ----------
    name : str
        For example ``compliance2``.
    unit : str
    block : str
        Columns of one block are judged together. A block that begins with ``+`` only refines others: alone it is not
        the effect.
    lower, upper : float
        Physical bounds of the parameter; a value outside is an alias of something else, not a finding.
    where : str
        What it acts on, for people: ``joint 2``, ``link 3``, ``base``, ``tool``, ``tracker``.
    joint : int or None
        The joint it turns, from 0; None where it acts otherwise.
    offset : array, shape (n,), or None
        Offset of that joint per unit [rad].
    shift_M : array, shape (n, 3), or None
        Shift of the measured SMR per unit [m] in the tracker frame, where ``joint`` is None.
    """

    name: str
    unit: str
    block: str
    lower: float
    upper: float
    where: str
    joint: int | None = None
    offset: Array | None = field(default=None, repr=False)
    shift_M: Array | None = field(default=None, repr=False)


def joint_column(
    name: str, unit: str, joint: int, offset: Array, lower: float, upper: float, block: str | None = None
) -> EffectColumn:
    """A column that turns one joint (from 0); its block is the joint unless given."""
    where = f"joint {joint + 1}"
    return EffectColumn(name, unit, block or where, lower, upper, where, joint=joint, offset=offset)


def shift_column(
    name: str, unit: str, where: str, shift_M: Array, lower: float, upper: float, block: str | None = None
) -> EffectColumn:
    """A column that shifts the SMR (n, 3) [m per unit, tracker frame]; its block is ``where`` unless given."""
    return EffectColumn(name, unit, block or where, lower, upper, where, shift_M=shift_M)


@dataclass(frozen=True)
class Law:
    """One way in which an effect may depend on the circumstances.

    Attributes
    ----------
    name : str
    constants : mapping
        Numbers that its columns need beside the circumstances, such as ``onset_s``.
    tried : int
        Among how many of its kind it was chosen (onsets, time constants): choosing costs 2 ln(tried) of its score.
    """

    name: str = ""
    constants: Mapping[str, float] = field(default_factory=dict)
    tried: int = 1


PLAIN = Law()


def unknown_law(slug: str, law: Law) -> ValueError:
    """An error, to be raised: the effect has no such law."""
    return ValueError(f"effect {slug} has no law '{law.name}' in this version of the program")


class Effect(Protocol):
    """A physical effect by its name in the field."""

    slug: str
    """Its name in reports and JSON."""
    title: str
    """The field's words for it."""
    look_alikes: tuple[str, ...]
    """Slugs of effects that data may not tell apart from it."""
    variables: frozenset[str]
    """What it depends on: q, torque, payload, approach, step, dwell, time, temperature, other_arm, beam, incidence."""

    def untestable(self, context: EffectContext) -> str:
        """What the data lack to look for it at all, in words ("no approach signs"); empty when they can be asked."""

    def laws(self, context: EffectContext) -> list[Law]:
        """The laws to try with the data at hand, the plainest first."""

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """Columns of a law, the same ones whatever the data; with ``wanted`` at least those of these names."""


@runtime_checkable
class Refinable(Protocol):
    """An effect that knows further laws once something of it was found."""

    def refinements(self, context: EffectContext, law: Law, names: Collection[str]) -> list[Law]:
        """Laws that are worth a try where ``law`` with the columns ``names`` was found."""


@dataclass(frozen=True)
class EffectTerm:
    """An effect that was found and became part of a model: law, parameter names, values, standard errors and units.

    ``note`` describes a data-driven term. ``spread`` is the standard deviation of a free curve [rad] of each joint
    (from 0) at equal steps of the joint angle from -pi to pi; empty where the parameters' standard errors say it all.
    """

    slug: str
    names: tuple[str, ...]
    values: Array
    standard_errors: Array
    units: tuple[str, ...]
    law: Law = PLAIN
    note: str = ""
    spread: Mapping[int, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Moved:
    """What terms do at n stops: joint offsets (n, N) [rad] and shifts of the SMR (n, 3) [m] in the tracker frame."""

    joints: Array
    shift_M: Array


def moved_by(terms: Sequence[EffectTerm], effects: Mapping[str, Effect], context: EffectContext) -> Moved:
    """What the terms of a model do."""
    joints, shift_M = np.zeros(context.q.shape), np.zeros((len(context), 3))
    for term in terms:
        columns = {c.name: c for c in effects[term.slug].columns(context, term.law, frozenset(term.names))}
        for name, value in zip(term.names, term.values.tolist(), strict=True):
            column = columns[name]
            if column.joint is not None:
                assert column.offset is not None
                joints[:, column.joint] += value * column.offset
            else:
                assert column.shift_M is not None
                shift_M += value * column.shift_M
    return Moved(joints, shift_M)


def varies(values: Array | NDArray[np.int8] | None) -> bool:
    """Whether something is known at all stops and not the same at each."""
    if values is None or len(values) == 0:
        return False
    known = np.asarray(values, dtype=np.float64)
    return bool(np.isfinite(known).all() and np.ptp(known, axis=0).max() > 0.0)
