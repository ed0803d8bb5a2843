"""Possible displacement of the SMR because a condition that effects of the model depend on was not stated.

A condition that is not stated is assumed at a default: payload as in the profile, temperatures at the mean of the run,
time at its end, dwell as in the run. A side of approach is chosen and stated with the command: the
effect of another side is reported, but is not an uncertainty. Plausible ranges are

- payload: from the profile's to what the run covered; no unknown if all readings had the profile's payload;
- temperature and time: what the run covered;
- dwell: from zero to the longest of the run, because production may not wait.

The stated size is the largest distance of the SMR from its position at the default; the covariance is the second moment
of that displacement, with conditions distributed uniformly over their ranges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.targets.invert import Inverted, invert
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.cell.targets.records import UnknownCondition
from cellapp.robot.effects import EFFECTS, DriverVariable, EffectTerm, MeasurementConditions
from cellapp.robot.kinematics.chain import JointAngles, joint_jacobian
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_POINTS = np.linspace(0.0, 1.0, 5)
"""Relative positions in a range where effects are evaluated: effects are monotonic or slow in their conditions."""
_MATTERS_M = 1e-6
"""Smallest displacement [m] that matters: a command may miss its target by a micrometre anyway."""


@dataclass(frozen=True, eq=False)
class OneUnknown:
    """Effect of one unknown condition at n commands.

    Attributes
    ----------
    condition : str
    effects : tuple of str
        Slugs of the effects that depend on it.
    largest_m : array, shape (n,)
        Largest distance of the SMR from its position at the default [m]; zero if the condition is stated.
    covariance : array, shape (n, 3, 3)
        Second moment of that displacement [m^2].
    """

    condition: str
    effects: tuple[str, ...]
    largest_m: Array
    covariance: Array

    def take(self, rows: NDArray[np.intp]) -> OneUnknown:
        """Return the same for some of the commands."""
        return replace(self, largest_m=self.largest_m[rows], covariance=self.covariance[rows])


@dataclass(frozen=True, eq=False)
class Sides:
    """Effect of the joints' sides of approach at n commands that do not state them.

    Attributes
    ----------
    effects : tuple of str
        Slugs of the effects that depend on the sides.
    vectors : array, shape (n, N, 3)
        Displacement of the SMR by each joint's positive side from the middle of both sides [m].
    """

    effects: tuple[str, ...]
    vectors: Array

    @property
    def matter(self) -> NDArray[np.bool_]:
        """Mask (n, N) of joints whose side matters."""
        return np.asarray(np.linalg.norm(self.vectors, axis=2) >= _MATTERS_M)

    def other_sides(self, signs: Array) -> OneUnknown:
        """Return the effect of other sides than ``signs`` (n, N), for which the commands were computed.

        This is no uncertainty, because a command states its sides. A command without sides is computed for the middle;
        then either side is equally likely.
        """
        sided = np.any(signs != 0.0, axis=1)
        taken = 2.0 * signs[:, :, None] * self.vectors  # from the chosen side of a joint to the other one
        away = np.einsum("sj,njc->nsc", np.array(list(product((0.0, 1.0), repeat=taken.shape[1]))), taken)
        largest = np.linalg.norm(away, axis=2).max(axis=1)
        covariance = np.where(sided[:, None, None], 0.0, _second_moment(self.vectors))
        return OneUnknown("approach", self.effects, np.where(sided, largest, _largest_sum(self.vectors)), covariance)


def unknown_conditions(
    arm: ArmModel, q: Array, conditions: MeasurementConditions, ranges: ConditionRanges
) -> list[OneUnknown]:
    """Return the conditions, except the approach, that are not stated for some of n commands ``q`` (n, N) [rad] and
    that matter there."""
    found = [
        _over_range("payload", arm, q, conditions, _payloads(arm, ranges)),
        _over_range("temperature", arm, q, conditions, _temperatures(ranges)),
        _over_range("time", arm, q, conditions, _times(ranges)),
        _dwell(arm, q, conditions, ranges),
    ]
    return [one for one in found if one is not None and one.largest_m.max(initial=0.0) >= _MATTERS_M]


def approach_sides(arm: ArmModel, q: Array, conditions: MeasurementConditions, ranges: ConditionRanges) -> Sides | None:
    """Return the effect of sides not stated by n commands ``q`` (n, N) [rad]; None if no effect depends on sides."""
    terms = _dependent(arm, "approach")
    if not terms:
        return None
    mover = _Mover.of(arm, terms, q, conditions.R_M_S)
    stated = np.zeros(q.shape) if conditions.approach is None else np.asarray(conditions.approach, dtype=np.float64)
    vectors = []
    for joint in range(q.shape[1]):
        plus, minus = (mover.shift(_driven(conditions, stated, joint, side, ranges)) for side in (1.0, -1.0))
        vectors.append(np.where(stated[:, joint, None] == 0.0, 0.5 * (plus - minus), 0.0))
    return Sides(_slugs(terms), np.stack(vectors, axis=1))


def unknown_records(found: Sequence[OneUnknown], row: int) -> tuple[UnknownCondition, ...]:
    """Return the conditions that matter to one command, for its result."""
    return tuple(
        UnknownCondition(condition=one.condition, effects=one.effects, mm=float(one.largest_m[row]) * 1e3)
        for one in found
        if one.largest_m[row] >= _MATTERS_M
    )


# -- inside -----------------------------------------------------------------------------------------------------------

_Change = Callable[[MeasurementConditions, float, int], MeasurementConditions]
"""Function that returns the conditions of n commands with one of them at a relative position (0 to 1) in its range."""

_DEPENDENT = {
    "approach": frozenset({DriverVariable.APPROACH, DriverVariable.STEP}),
    "payload": frozenset({DriverVariable.PAYLOAD, DriverVariable.TORQUE}),
    "temperature": frozenset({DriverVariable.AIR_TEMPERATURE, DriverVariable.JOINT_TEMPERATURE}),
    "time": frozenset({DriverVariable.TIME}),
    "dwell": frozenset({DriverVariable.DWELL}),
}
_STATED = {"payload": "payload_kg", "temperature": "air_c", "time": "time_s", "dwell": "dwell_s"}


def _dependent(arm: ArmModel, condition: str) -> tuple[EffectTerm, ...]:
    """Return the model's effects that depend on a condition."""
    return tuple(term for term in arm.effects if _variables(term) & _DEPENDENT[condition])


def _variables(term: EffectTerm) -> frozenset[DriverVariable]:
    own = term.law.form.variables or EFFECTS[term.slug].variables
    return own | {one.driver.driver for one in term.modulations if one.driver is not None}


def _unstated(conditions: MeasurementConditions, condition: str, n: int) -> NDArray[np.bool_]:
    values = getattr(conditions, _STATED[condition])
    return np.ones(n, dtype=bool) if values is None else np.isnan(values)


@dataclass(frozen=True, eq=False)
class _Mover:
    """Displacements of the SMR by some effects at configurations ``q`` (n, N) [rad]."""

    arm: ArmModel
    q: Array
    by_joint: Array

    @classmethod
    def of(cls, arm: ArmModel, terms: tuple[EffectTerm, ...], q: Array, R_M_S: Array | None) -> _Mover:
        _, by_joint = joint_jacobian(arm.geometry, JointAngles.of(q, R_M_S))
        return cls(replace(arm, effects=terms, network=None, posterior=None), q, by_joint)

    def shift(self, conditions: MeasurementConditions) -> Array:
        """Return the displacement (n, 3) [m] to first order in the joint offsets."""
        moved = self.arm.effect_displacement(self.q, conditions=conditions)
        return np.asarray(moved.shift_M + np.einsum("cjn,nj->nc", self.by_joint, moved.joints))


def _slugs(terms: Sequence[EffectTerm]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(term.slug for term in terms))


def _driven(
    conditions: MeasurementConditions, stated: Array, joint: int, side: float, ranges: ConditionRanges
) -> MeasurementConditions:
    """Return the conditions with one joint arriving from one side, with the run's usual step size if known."""
    approach = stated.copy()
    approach[:, joint] = side
    return replace(conditions, approach=approach, step=None if ranges.step is None else approach * ranges.step)


def _dwell(arm: ArmModel, q: Array, conditions: MeasurementConditions, ranges: ConditionRanges) -> OneUnknown | None:
    """Return the effect of a shorter rest: more of each joint's last motion remains, for either side."""
    terms = _dependent(arm, "dwell")
    if not terms or ranges.dwell_s is None or ranges.step is None:
        return None
    mover, n = _Mover.of(arm, terms, q, conditions.R_M_S), len(q)
    rows = _unstated(conditions, "dwell", n)
    each = []
    for joint in range(q.shape[1]):
        driven = _driven(conditions, np.zeros(q.shape), joint, 1.0, ranges)
        default = mover.shift(driven)
        each.append(
            [mover.shift(replace(driven, dwell_s=np.full(n, place * ranges.dwell_s[1]))) - default for place in _POINTS]
        )
    moved = np.where(rows[:, None, None], np.array(each).transpose(1, 2, 0, 3), 0.0)
    largest = np.max([_largest_sum(one) for one in moved], axis=0)
    covariance = np.mean([_second_moment(one) for one in moved], axis=0)
    return OneUnknown("dwell", _slugs(terms), largest, covariance)


def _over_range(
    condition: str, arm: ArmModel, q: Array, conditions: MeasurementConditions, change: _Change | None
) -> OneUnknown | None:
    """Return the effect of a condition that moves the SMR along one curve over its range."""
    terms = _dependent(arm, condition)
    if not terms or change is None:
        return None
    mover, n = _Mover.of(arm, terms, q, conditions.R_M_S), len(q)
    default = mover.shift(conditions)
    moved = np.array([mover.shift(change(conditions, place, n)) - default for place in _POINTS.tolist()])
    moved = np.where(_unstated(conditions, condition, n)[:, None], moved, 0.0)
    largest = np.linalg.norm(moved, axis=2).max(axis=0)
    covariance = np.einsum("pna,pnb->nab", moved, moved) / len(moved)
    return OneUnknown(condition, _slugs(terms), largest, covariance)


def _payloads(arm: ArmModel, ranges: ConditionRanges) -> _Change | None:
    nominal = arm.bodies.payload_mass
    low, high = ranges.payload_kg or (nominal, nominal)
    low, high = min(low, nominal), max(high, nominal)
    if low == high:
        return None
    return lambda conditions, place, n: replace(conditions, payload_kg=np.full(n, low + place * (high - low)))


def _temperatures(ranges: ConditionRanges) -> _Change | None:
    if ranges.air_c is None and ranges.joints_c is None:
        return None

    def change(conditions: MeasurementConditions, place: float, n: int) -> MeasurementConditions:
        joints_c = ranges.joints_c
        low, high = ranges.air_c or (0.0, 0.0)
        return replace(
            conditions,
            air_c=None if ranges.air_c is None else np.full(n, low + place * (high - low)),
            joints_c=None if joints_c is None else np.tile(joints_c[0] + place * (joints_c[1] - joints_c[0]), (n, 1)),
        )

    return change


def _times(ranges: ConditionRanges) -> _Change | None:
    if ranges.time_s is None and ranges.stops < 2:
        return None

    def change(conditions: MeasurementConditions, place: float, n: int) -> MeasurementConditions:
        low, high = ranges.time_s or (np.nan, np.nan)
        return replace(
            conditions,
            time_s=np.full(n, low + place * (high - low)),
            order=np.full(n, place * (ranges.stops - 1)),
        )

    return change


def _largest_sum(vectors: Array) -> Array:
    """Return the largest length (n,) of the sum of vectors (n, N, 3), each with either sign."""
    signs = np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=vectors.shape[1] - 1)])
    return np.asarray(np.linalg.norm(np.einsum("sj,njc->nsc", signs, vectors), axis=2).max(axis=1))


def _second_moment(vectors: Array) -> Array:
    """Return the covariance (n, 3, 3) of the sum of vectors (n, N, 3), each with a random sign."""
    return np.asarray(np.einsum("nja,njb->nab", vectors, vectors))


# -- Sides of approach: the side from which each joint arrives at a command, which is valid for it and states it ------
#
# Backlash, hysteresis and friction make the SMR depend on where a joint came from. A target may state the side. If it
# does not, and the side matters to the model, the command is for the way from home; its signs are stated wherever the
# command is written, so that an operator can drive accordingly.


@dataclass(frozen=True, eq=False)
class SidedCommands:
    """Commands of n targets, each for a side of approach.

    Attributes
    ----------
    found : Inverted
    conditions : MeasurementConditions
        Conditions that the commands are for: as stated by the targets, and the sides.
    signs : array, shape (n, N), int
        Sign of each joint's last motion, as stated or as on the way from home; 0 if it does not matter.
    others : OneUnknown or None
        Effect of other sides; None if no effect depends on them.
    """

    found: Inverted
    conditions: MeasurementConditions
    signs: Array
    others: OneUnknown | None

    def approach(self, row: int) -> tuple[int, ...] | None:
        """Return the signs of one command; None if any side will do."""
        signs = tuple(int(sign) for sign in self.signs[row])
        return signs if any(signs) else None


def sided_commands(
    arm: ArmModel,
    position_M: Array,
    rotation_M: Array,
    found: Inverted,
    conditions: MeasurementConditions,
    home: Array,
    ranges: ConditionRanges,
) -> SidedCommands:
    """Invert the model again for the sides of arrival, starting from n commands ``found`` for the middle of both sides.

    ``position_M`` (n, 3) and ``rotation_M`` (n, 3, 3) are as in ``invert``; the way begins at ``home`` (N,) [rad].
    """
    q = found.q
    stated = np.zeros(q.shape) if conditions.approach is None else np.asarray(conditions.approach, dtype=np.float64)
    sides = approach_sides(arm, q, conditions, ranges) if len(q) else None
    if sides is None:
        return SidedCommands(found, conditions, stated, None)
    step = q - home
    offered = np.where(step < 0.0, -1.0, 1.0) * sides.matter
    signs = np.where(stated != 0.0, stated, offered)
    rows = np.flatnonzero(offered.any(axis=1))
    if not len(rows):
        return SidedCommands(found, conditions, signs, sides.other_sides(signs))
    usual = np.full(q.shape[1], np.nan) if ranges.step is None else ranges.step
    sizes = np.where(stated != 0.0, usual, np.abs(step))
    made = replace(conditions, approach=signs, step=sizes * signs)
    again = invert(arm, position_M[rows], rotation_M[rows], q[rows], made.take(rows))
    kept = Inverted(q.copy(), found.residual_m.copy(), found.residual_rad.copy())
    kept.put(rows[again.reached], again, again.reached)
    lost = np.setdiff1d(rows, rows[again.reached])  # such a command stays at the middle, without a side
    signs[lost] = stated[lost]
    if len(lost):
        made = replace(made, approach=signs, step=np.where(signs == 0.0, np.nan, sizes * signs))
    return SidedCommands(kept, made, signs, sides.other_sides(signs))


def holds_for(command_signs: Sequence[int] | None, *, payload_kg: float | None, stated: Sequence[str]) -> str:
    """Describe what a row of a command is valid for: sides of the last motions, payload, what the target states."""
    parts = ["any side of approach"]
    if command_signs is not None and any(command_signs):
        parts = [f"joints that arrive with the signs {signs_words(command_signs)}"]
    if payload_kg is not None:
        parts.append(f"payload {payload_kg:g} kg")
    return "; ".join([*parts, *stated])


def signs_words(signs: Sequence[int]) -> str:
    """Format signs of last motions as in columns: ``-1 +1 0``."""
    return " ".join(f"{sign:+d}" if sign else "0" for sign in signs)


def from_home(conditions: MeasurementConditions, q: Array, home: Array) -> MeasurementConditions:
    """Return the conditions with joints of unknown approach arriving straight from home."""
    step = q - home
    approach = np.sign(step)
    if conditions.approach is not None:
        stated = np.asarray(conditions.approach, dtype=np.float64)
        approach = np.where(stated == 0.0, approach, stated)
    return replace(conditions, approach=approach, step=np.abs(step) * approach)
