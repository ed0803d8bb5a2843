"""Uncertainty of the SMR's position at a command: covariance by source, and bounds of the distance from the target.

Command of an arm for one target, with its prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from cellapp.cell.targets.ranges import (
    ConditionRanges,
    OneUnknown,
    conditions_of,
    conditions_payload,
    from_home,
    payload_covariance,
    signs_words,
    unknown_conditions,
    unknown_records,
)
from cellapp.cell.targets.records import PredictedRelative, PredictedRotation, TargetCommand, UnknownCondition
from cellapp.cell.targets.targets import Target, target_record
from cellapp.estimation.uncertainty.budget import TARGET_WORDS, decided
from cellapp.estimation.uncertainty.records import ToleranceVerdict, UncertaintyParts
from cellapp.ground.counting import mm
from cellapp.ground.profile import SAME_PAYLOAD_KG
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, rotation_vectors
from cellapp.robot.model import ArmModel
from cellapp.robot.model.model import PosteriorSamples

AT_ONCE = 1000
"""Number of configurations per batch: their posterior samples take some tens of MB."""


@dataclass(frozen=True, eq=False)
class Extent:
    """Covariances (n, 3, 3) [m^2] of the predicted SMR by source; their sum is that of the true position.

    Geometry and effects are fitted together, and their errors partly cancel: each gets its share of the covariance of
    their sum (Euler's allocation of a variance).
    """

    parameters: Array
    effects: Array
    network: Array
    extrapolation: Array
    conditions: Array

    @property
    def of_model(self) -> Array:
        """Covariance of the true position under the conditions of the command."""
        return self.parameters + self.effects + self.network + self.extrapolation

    @property
    def whole(self) -> Array:
        """Covariance of the true position under all plausible values of conditions that are not stated."""
        return self.of_model + self.conditions


def predictions(
    arm: ArmModel,
    q: Array,
    conditions: MeasurementConditions,
    tolerances_mm: Sequence[float | None],
    home: Array,
    ranges: ConditionRanges,
    others: OneUnknown | None = None,
) -> list[Prediction | None]:
    """Return predictions for n commands ``q`` (n, N) [rad]; None for all if the model states no uncertainty.

    ``conditions`` are those of the commands. Joints without a side of approach are treated as arriving from ``home``
    (N,): halfway between both sides a backlash parameter would have no uncertainty. ``others`` is the effect of other
    sides.
    """
    if arm.posterior is None:
        return [None] * len(q)
    found: list[Prediction | None] = []
    for begin in range(0, len(q), AT_ONCE):
        rows = np.arange(begin, min(begin + AT_ONCE, len(q)))
        here, stated = q[rows], conditions.take(rows)
        unknown = [*([] if others is None else [others.take(rows)]), *unknown_conditions(arm, here, stated, ranges)]
        spread = spread_of(arm, here, from_home(stated, here, home), ranges)
        covariance = sum((one.covariance for one in unknown), np.zeros_like(spread.network))
        spread = replace(spread, conditions=covariance)
        noise, of_run = _noise(arm, here, stated, ranges), arm.noise(here)
        excess = np.zeros(len(here)) if ranges.noise is None else ranges.noise.excess(of_run)
        judged = _judged(spread, noise, excess, tolerances_mm[begin : begin + AT_ONCE])
        found += [replace(one, unknown=unknown_records(unknown, k)) for k, one in enumerate(judged)]
    return found


def outside_notes(
    q: Array,
    conditions: MeasurementConditions,
    ranges: ConditionRanges,
    predicted: Sequence[Prediction | None],
    nominal_kg: float,
) -> list[str]:
    """Describe for each of n commands how far it is outside the joint ranges and payloads of the readings; empty if it
    is inside. ``nominal_kg`` is the payload if none is stated [kg]."""
    off = np.degrees(np.abs(q - ranges.nearest_measured(q)))
    payloads = conditions_payload(conditions, nominal_kg, len(q))
    notes = []
    for row, payload_kg, one in zip(off, payloads.tolist(), predicted, strict=True):
        joints = ", ".join(f"joint {j + 1} by {row[j]:.0f} deg" for j in np.flatnonzero(row >= 0.5))
        said = [f"outside the calibrated joint ranges: {joints}"] if joints else []
        said += _never_measured(payload_kg, ranges)
        adds = "" if one is None else f"; this adds {mm(one.parts.extrapolation)} to the uncertainty of a coordinate"
        notes.append(f"{'; '.join(said)}{adds}" if said else "")
    return notes


def _never_measured(payload_kg: float, ranges: ConditionRanges) -> list[str]:
    """Report a payload that no reading had."""
    if ranges.payload_kg is None:
        return []
    low, high = ranges.payload_kg
    if low - SAME_PAYLOAD_KG <= payload_kg <= high + SAME_PAYLOAD_KG:
        return []
    had = f"{low:g} kg" if high - low <= SAME_PAYLOAD_KG else f"{low:g} to {high:g} kg"
    return [f"payload {payload_kg:g} kg was never measured (the readings had {had})"]


def spread_of(arm: ArmModel, q: Array, conditions: MeasurementConditions, ranges: ConditionRanges) -> Extent:
    """Return the covariances of a model with posterior samples at ``q`` (n, N) [rad].

    Outside the joint ranges of the readings, ``extrapolation`` is what exceeds the values at the nearest configuration
    inside: additional spread of geometry and effects, and the network's correction, which fades out there although the
    errors that it corrects do not. A payload that no reading had adds to it, too.
    """
    inside = ranges.nearest_measured(q)
    near = ranges.nearest_loaded(arm, q, conditions)
    parameters, effects, network = _of_model(arm, q, near)
    nothing = np.zeros_like(parameters)
    extrapolation = payload_covariance(arm, q, conditions, near, ranges.elasticity)
    beyond = np.flatnonzero(np.any(inside != q, axis=1))
    if not len(beyond):
        return Extent(parameters, effects, network, extrapolation, nothing)
    within = _of_model(arm, inside[beyond], near.take(beyond))
    for here, there in zip((parameters, effects), within[:2], strict=True):
        share = np.minimum(_size(there) / np.maximum(_size(here[beyond]), 1e-300), 1.0)[:, None, None]
        extrapolation[beyond] += (1.0 - share) * here[beyond]
        here[beyond] *= share
    network[beyond] = within[2]
    if arm.network is not None:
        lost = arm.network.correct(inside[beyond]) - arm.network.correct(q[beyond])
        lost = lost @ arm.geometry.T_M_B()[:3, :3].T
        extrapolation[beyond] += lost[:, :, None] * lost[:, None]
    return Extent(parameters, effects, network, extrapolation, nothing)


# -- inside -----------------------------------------------------------------------------------------------------------


def _of_model(arm: ArmModel, q: Array, conditions: MeasurementConditions) -> tuple[Array, Array, Array]:
    """Return the covariances (n, 3, 3) [m^2] of geometry, effects and network at ``q`` (n, N) [rad]."""
    assert arm.posterior is not None
    by_geometry, by_terms = arm.posterior.displacements_by_part(
        arm.geometry, arm.effects, arm.context(q, conditions=conditions)
    )
    moved = by_geometry + by_terms
    whole = np.einsum("sna,snb->nab", moved, moved, optimize=True) / len(moved)
    own = np.einsum("sna,sna->n", by_geometry, moved) / len(moved)
    share = np.clip(own / np.maximum(_size(whole), 1e-300), 0.0, 1.0)[:, None, None]
    network = np.zeros_like(whole)
    if arm.network is not None:
        R = arm.geometry.T_M_B()[:3, :3]
        network = (R * arm.network.spread(q)[:, None] ** 2) @ R.T
    return share * whole, (1.0 - share) * whole, network


def _noise(arm: ArmModel, q: Array, conditions: MeasurementConditions, ranges: ConditionRanges) -> Array:
    """Return the covariance (n, 3, 3) [m^2] of a measurement at ``q`` (n, N) [rad]."""
    if ranges.noise is None:
        return np.asarray(np.multiply.outer(arm.noise(q) ** 2, np.eye(3)))
    return ranges.noise.covariance(arm.predict(q, conditions=conditions), arm.noise(q))


def _judged(spread: Extent, noise: Array, excess: Array, tolerances_mm: Sequence[float | None]) -> list[Prediction]:
    """Return predictions in mm from covariances: ``noise`` of a measurement; ``excess`` (n,) [m^2] of it is motion.

    Uncertainty and upper bound refer to what a measurement will find, with one covariance. Only the distance that the
    SMR surely exceeds refers to the SMR itself.
    """
    parts = {name: _component(value) for name, value in vars(spread).items()}
    parts["noise"], whole = _component(noise), _component(spread.whole + noise)
    bounds = _bounds(spread.whole + np.multiply.outer(excess, np.eye(3)), spread.whole + noise, tolerances_mm)
    return [
        Prediction(
            uncertainty_mm=float(whole[k]),
            parts=UncertaintyParts(**{name: float(value[k]) for name, value in parts.items()}),
            within_mm=within,
            unknown=(),
            verdict=verdict,
        )
        for k, (within, verdict) in enumerate(bounds)
    ]


def _size(covariance: Array) -> Array:
    """Return the sum of the variances (n,) [m^2] of the coordinates."""
    return np.asarray(np.trace(covariance, axis1=1, axis2=2))


def _component(covariance: Array) -> Array:
    """Return the root mean square standard deviation (n,) [mm, mrad] of a coordinate or a component of rotation."""
    return np.asarray(np.sqrt(_size(covariance) / 3.0) * 1e3)


# -- Predict whether a target will be met within its tolerance, from the model's uncertainty --------------------------
#
# An error x is a normal vector with zero mean and covariance C. Its squared length is a sum of squares weighted with
# the eigenvalues of C, so that all of its cumulants follow from traces:
#
#     k1 = tr C,  k2 = 2 tr C^2,  k3 = 8 tr C^3.
#
# The upper quantile is that of a shifted gamma distribution with these three cumulants (Hall, Buckley, Eagleson:
# Buckley, Eagleson, Australian J. Statist. 30A (1988) 150). It is exact if all non-zero weights are equal; for any
# weights its 95 % quantile is exceeded with 4.7 to 5.0 % probability. The lower quantile is that of a gamma
# distribution with two cumulants (Satterthwaite 1946), because the shift is too coarse there; it is at most the true
# quantile.


LIKELY = 0.95
"""Probability of all statements about tolerances."""


def length_bounds(covariance: Array) -> tuple[Array, Array]:
    """Return the lengths (n,) that normal vectors exceed, and those that they stay within, with 95 % probability.

    ``covariance`` (n, 3, 3) and the lengths have the same unit of length. Zero for zero covariance.
    """
    squared = covariance @ covariance
    k1 = np.trace(covariance, axis1=1, axis2=2)
    k2 = 2.0 * np.trace(squared, axis1=1, axis2=2)
    k3 = 8.0 * np.einsum("nij,nji->n", squared, covariance)
    some = k1 > 0.0
    k1, k2, k3 = (np.where(some, k, 1.0) for k in (k1, k2, k3))
    freedom = 8.0 * k2**3 / k3**2
    high = k1 + np.sqrt(0.5 * k2 / freedom) * (2.0 * scipy.special.gammaincinv(0.5 * freedom, LIKELY) - freedom)
    low = 0.5 * k2 / k1 * 2.0 * scipy.special.gammaincinv(k1**2 / k2, 1.0 - LIKELY)
    return np.sqrt(np.where(some, low, 0.0)), np.sqrt(np.where(some, high, 0.0))


def _bounds(true: Array, measured: Array, tolerances: Sequence[float | None]) -> list[tuple[float, ToleranceVerdict]]:
    """Return the bound [mm, mrad] of each measured error, and its verdict, from covariances (n, 3, 3) [m^2, rad^2]: of
    the true error and of the one that a measurement finds."""
    low, high = length_bounds(true)[0] * 1e3, length_bounds(measured)[1] * 1e3
    return [
        (within, predicted_verdict(surely, within, tolerance))
        for surely, within, tolerance in zip(low.tolist(), high.tolist(), tolerances, strict=True)
    ]


def predicted_verdict(low_mm: float, high_mm: float, tolerance_mm: float | None) -> ToleranceVerdict:
    """Judge a compensated command before it is driven, by the common decision rule, guarded.

    The model expects the SMR at the target. ``low_mm`` and ``high_mm`` are ``length_bounds``: of the SMR's error, and
    of the error that a measurement finds. "in": with 95 % probability the error is within ``tolerance_mm``; "out": with
    95 % probability it is larger; "not decided": neither. Empty without a tolerance. Deficiencies of the model are not
    part of its uncertainty: only a measurement reveals them.
    """
    return "" if tolerance_mm is None else TARGET_WORDS[decided(low_mm, high_mm, tolerance_mm)]


# -- Uncertainty of the flange's orientation at a command, if readings of the arm had orientations --------------------


def predicted_rotations(
    arm: ArmModel,
    q: Array,
    q_nominal: Array,
    conditions: MeasurementConditions,
    nominal_M: Array,
    tolerances_mrad: Sequence[float | None],
    home: Array,
    ranges: ConditionRanges,
) -> list[PredictedRotation | None]:
    """Return predictions for n commands ``q`` (n, N) [rad]; None for all if the model has no orientation noise.

    ``q_nominal`` (n, N) are the commands of the published geometry, ``nominal_M`` (n, 3, 3) the flange rotations of the
    targets in the tracker frame with the nominal base, NaN if any will do. The other arguments are as in
    ``prediction.predictions``.
    """
    if arm.posterior is None or arm.posterior.noise.rad is None:
        return [None] * len(q)
    found: list[PredictedRotation | None] = []
    for begin in range(0, len(q), AT_ONCE):
        rows = np.arange(begin, min(begin + AT_ONCE, len(q)))
        here, stated = q[rows], conditions.take(rows)
        came = from_home(stated, here, home)
        rotated = arm.orientation(here, came)
        model = _covariance(arm, here, replace(came, R_M_S=rotated), ranges)
        unknown = unknown_conditions(arm, here, replace(stated, R_M_S=rotated), ranges)
        true = model + sum((one.covariance for one in unknown), np.zeros_like(model))
        off = _off_mrad(arm, q_nominal[rows], stated, nominal_M[rows])
        measured = _with_noise(true, arm.posterior)
        limits = [None if free is None else limit for free, limit in zip(off, tolerances_mrad[begin : begin + AT_ONCE])]
        found += [
            PredictedRotation(
                nominal_mrad=off[k],
                uncertainty_mrad=float(whole_mrad),
                model_mrad=float(model_mrad),
                noise_mrad=arm.posterior.noise.rad * 1e3,
                within_mrad=within,
                verdict=verdict,
            )
            for k, (whole_mrad, model_mrad, (within, verdict)) in enumerate(
                zip(_component(measured), _component(model), _bounds(true, measured, limits), strict=True)
            )
        ]
    return found


def _covariance(arm: ArmModel, q: Array, conditions: MeasurementConditions, ranges: ConditionRanges) -> Array:
    """Return covariances (n, 3, 3) [rad^2] of orientations at ``q`` (n, N) [rad] from a model's posterior samples."""
    assert arm.posterior is not None
    near = ranges.nearest_loaded(arm, q, conditions)
    moved = arm.posterior.displacements(arm.geometry, arm.effects, arm.context(q, conditions=near))
    covariance = np.einsum("sna,snb->nab", moved, moved, optimize=True) / len(moved)
    if arm.network is not None and arm.network.rotation is not None:
        R = arm.geometry.T_M_B()[:3, :3]
        covariance += (R * arm.network.rotation.spread(q)[:, None] ** 2) @ R.T
    return np.asarray(covariance + payload_covariance(arm, q, conditions, near, ranges.elasticity))


def _off_mrad(arm: ArmModel, q: Array, conditions: MeasurementConditions, wanted_M: Array) -> list[float | None]:
    """Return the angles [mrad] between the model's flange rotations and the n wanted ones; None if any will do."""
    free = np.isnan(wanted_M[:, 0, 0])
    wanted = np.where(free[:, None, None], np.eye(3), wanted_M)
    off = np.linalg.norm(rotation_vectors(arm.flange(q, conditions)[0] @ wanted.swapaxes(1, 2)), axis=1) * 1e3
    return [None if any_will_do else angle for any_will_do, angle in zip(free.tolist(), off.tolist(), strict=True)]


def _with_noise(true: Array, posterior: PosteriorSamples) -> Array:
    """Return covariances (n, 3, 3) [rad^2] of measured orientations: those of the ``true`` ones plus noise.

    With several SMRs the axes of the noise depend on the viewing direction. They are assumed along the principal axes
    of ``true``, largest with largest, which gives the widest bound.
    """
    assert posterior.noise.rad is not None
    if posterior.noise.axes_rad is None:
        return np.asarray(true + posterior.noise.rad**2 * np.eye(3))
    values, vectors = np.linalg.eigh(true)
    return np.asarray(np.einsum("nab,nb,ncb->nac", vectors, values + posterior.noise.axes_rad**2, vectors))


# -- Pose of one flange in another's frame: both arms' uncertainties, and the lever of the first one's rotation --------


@dataclass(frozen=True, eq=False)
class Predicted:
    """What is predicted of one arm at n commands ``q`` (n, N) [rad]; the way to them begins at ``home`` (N,)."""

    arm: ArmModel
    q: Array
    conditions: MeasurementConditions
    home: Array
    positions: Sequence[Prediction | None]
    rotations: Sequence[PredictedRotation | None]

    def samples(self) -> tuple[Array, Array, Array]:
        """Return SMR positions (n, 3) [m], and samples (S, n, 3) of their errors [m] and of the orientations' [rad]."""
        assert self.arm.posterior is not None
        came = from_home(self.conditions, self.q, self.home)
        rotated = replace(came, R_M_S=self.arm.orientation(self.q, came))
        moved = [
            self.arm.posterior.displacements(
                self.arm.geometry, self.arm.effects, self.arm.context(self.q, conditions=its)
            )
            for its in (came, rotated)
        ]
        return self.arm.predict(self.q, conditions=came), moved[0], moved[1]

    def others(self, *samples: Array) -> Array:
        """Return the variances (2, n) of a coordinate [m^2] and of a component of rotation [rad^2] beside the
        samples."""
        known = zip(self.positions, self.rotations, strict=True)
        whole = [
            (one.uncertainty_mm, its.uncertainty_mrad) for one, its in known if one is not None and its is not None
        ]
        sampled = np.array([np.mean(one**2, axis=(0, 2)) for one in samples])
        return np.asarray(np.maximum((1e-3 * np.array(whole).T) ** 2 - sampled, 0.0))


def predicted_relative(
    first: Predicted, second: Predicted, tolerances_mm: Sequence[float | None], tolerances_mrad: Sequence[float | None]
) -> list[PredictedRelative | None]:
    """Return predictions of the second flange's pose in the first one's frame; None for all without two probes."""
    if not len(first.q) or None in (*first.rotations, *second.rotations, *first.positions, *second.positions):
        return [None] * len(first.q)
    model, measured = relative_covariances(first, second)
    distances, angles = (_bounds(*its) for its in zip(model, measured, (tolerances_mm, tolerances_mrad), strict=True))
    return [
        PredictedRelative(within_mm=within_mm, within_mrad=within_mrad, verdict=verdict, turn_verdict=turn_verdict)
        for (within_mm, verdict), (within_mrad, turn_verdict) in zip(distances, angles, strict=True)
    ]


def relative_covariances(first: Predicted, second: Predicted) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return the covariances (n, 3, 3) of the relative position [m^2] and rotation [rad^2]: model, and as measured.

    Seen from the first flange, its rotation by w moves the other SMR, at the vector d from its own, by ``-w x d``.
    """
    (p_1, moved_1, rotated_1), (p_2, moved_2, rotated_2) = first.samples(), second.samples()
    d = p_2 - p_1
    own, other = first.others(moved_1, rotated_1), second.others(moved_2, rotated_2)
    moved_1 = moved_1 + np.cross(rotated_1, d)

    def of(*samples: Array) -> Array:
        return np.asarray(sum(np.einsum("sna,snb->nab", one, one, optimize=True) / len(one) for one in samples))

    model = of(moved_1, moved_2), of(rotated_1, rotated_2)
    noise_m2, noise_rad2 = own + other
    lever = np.einsum("na,na->n", d, d)[:, None, None] * np.eye(3) - d[:, :, None] * d[:, None]
    added = noise_m2[:, None, None] * np.eye(3) + own[1, :, None, None] * lever, noise_rad2[:, None, None] * np.eye(3)
    return model, (model[0] + added[0], model[1] + added[1])


@dataclass(frozen=True, eq=False, kw_only=True)
class Prediction:
    """Uncertainty of the SMR's position at a command, under the names of ``TargetCommand``."""

    uncertainty_mm: float
    parts: UncertaintyParts
    within_mm: float
    unknown: tuple[UnknownCondition, ...]
    verdict: ToleranceVerdict


@dataclass(frozen=True, eq=False)
class Command:
    """The command of an arm for one target as it is stored, and what driving and measuring it needs.

    Attributes
    ----------
    target : Target
    record : TargetCommand
        A cooperative target has one for each of its arms.
    conditions : MeasurementConditions or None
        Working conditions that the command was computed for (one row), including the side of approach.
    expected_M, nominal_M : array, shape (3,), or None
        Expected measurement of the SMR [m]: the target relative to the calibrated and to the nominal base; None if the
        target was refused.
    rotation_M, nominal_rotation_M : array, shape (3, 3), or None
        Rotation of the flange at ``expected_M`` and ``nominal_M``; NaN if any will do.
    """

    target: Target
    record: TargetCommand
    conditions: MeasurementConditions | None = None
    expected_M: Array | None = None
    nominal_M: Array | None = None
    rotation_M: Array | None = None
    nominal_rotation_M: Array | None = None

    @property
    def stated_approach(self) -> tuple[int, ...] | None:
        """Side of each joint that the target states; None if it states none."""
        return self.target.approach if self.record.arm == self.target.arm else None

    def recording(self, **known: Any) -> Command:
        """Return it with other fields of its record, of their types."""
        return replace(self, record=self.record.model_copy(update=known))


def refused(target: Target, arm: str, refusal: str, branches: int | None = None) -> Command:
    """Return the command of a refused target, with the reason."""
    own = dict(target_record(target, arm))
    return Command(target, TargetCommand(**own, refusal=refusal, q_nominal=None, q_compensated=None, branches=branches))


def holds_for(command: Command) -> str:
    """Return what a compensated command is valid for: sides, payload, and conditions that its target states."""
    parts, record = ["any side of approach"], command.record
    if record.approach is not None and any(record.approach):
        parts = [f"joints that arrive with the signs {signs_words(record.approach)}"]
    stated = conditions_of(command.target, record.arm)
    for prefix, value, words in (
        ("payload ", record.payload_kg, "kg"),
        ("", stated.temperature, "degC"),
        ("", stated.time, "s after the run began"),
        ("", stated.dwell, "s at rest"),
    ):
        if value is not None:
            parts.append(f"{prefix}{value:g} {words}")
    return "; ".join(parts)
