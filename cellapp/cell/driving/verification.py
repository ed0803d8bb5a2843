"""Verification by measurement: compare wanted, predicted and measured SMR positions; detect that the model is wrong."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from cellapp.cell.driving.motion import Mover, PointAtRest
from cellapp.cell.targets.prediction import Command
from cellapp.cell.targets.records import (
    ArmVerification,
    MeasuredPair,
    MeasuredRelative,
    MeasuredRotation,
    MeasuredTarget,
    VerifyResult,
)
from cellapp.cell.targets.targets import target_record
from cellapp.estimation.calibration.quantities import summarise
from cellapp.estimation.calibration.station_location import beside
from cellapp.estimation.uncertainty.budget import Judge, angle_budget, expanded_mrad
from cellapp.ground.profile import SAME_PAYLOAD_KG
from cellapp.ground.results import ErrorSummary
from cellapp.robot.kinematics.transforms import Array, rotation_from_vector, rotation_vectors, rotations_of, xyz_of
from cellapp.robot.model import ArmModel, CellModel
from drivers.arms.protocol import ArmState
from drivers.trackers.protocol import Point

CommandKind = Literal["nominal", "compensated"]

_FAR_M = 1e-3
"""Distance from the prediction [m] that no calibrated arm shows, whatever uncertainty its model states."""
_FAR_RATIO = 5.0
"""Multiple of the stated 95 % distance above which the model's uncertainty cannot be the only cause."""
_FIRST_STREAK, _LATER_STREAK = 2, 5
"""Consecutive targets that disagree before the job ends: if none has agreed yet, and if one has."""
_WHAT_NOW = (
    "the tracker was moved, the SMR was mounted anew, or the arm has changed; the arms went home, and what was measured"
    " says nothing about the calibration. After moving the tracker run 'cellapp check DIR --tracker-moved'; else"
    " measure and calibrate again"
)


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurement of one arm at rest at a command.

    Attributes
    ----------
    sent, q : array, shape (N,)
        Commanded and reached joint positions [rad].
    approach : array, shape (N,)
        Sign of each joint's last motion, 0 where unknown.
    wanted_M, predicted_M : array, shape (3,)
        Target, and prediction of the calibrated model at ``q`` [m].
    point : Point
    repeatability_m : float
        Standard deviation of an SMR coordinate over repeated motions [m]; zero if unknown.
    angle_M : array, shape (3,), or None
        Rotation vector [rad] from the wanted to the measured rotation of the flange; None if not measured.
    """

    sent: Array
    q: Array
    approach: Array
    wanted_M: Array
    predicted_M: Array
    point: Point
    repeatability_m: float
    angle_M: Array | None = None

    @property
    def error_M(self) -> Array:
        """Vector from the target to the measured SMR, (3,) [m]."""
        return np.asarray(self.point.p_M - self.wanted_M)

    @property
    def error_m(self) -> float:
        """Distance of the measured SMR from the target [m]."""
        return float(np.linalg.norm(self.error_M))

    @property
    def unexpected_m(self) -> float:
        """Distance of the measured SMR from the prediction [m]."""
        return float(np.linalg.norm(self.point.p_M - self.predicted_M))

    @property
    def noise_M(self) -> Array:
        """Covariance (3, 3) of the error [m^2]: the tracker's, raised to the arm's repeatability if that is larger."""
        tracker = self.point.covariance_M
        added = max(self.repeatability_m**2 - float(np.trace(tracker)) / 3.0, 0.0)
        return np.asarray(tracker + added * np.eye(3))


def mean_of(measured: Sequence[Measured]) -> Measured:
    """Return the mean of n measurements of one arm at the same command, with the covariance of a mean.

    The repeatability is the scatter of the measurements if that is larger than the known value.
    """
    first, n = measured[0], len(measured)
    scatter_m = float(np.sqrt(np.var([one.error_M for one in measured], axis=0, ddof=1).mean())) if n > 1 else 0.0
    point = replace(
        first.point,
        p_M=np.mean([one.point.p_M for one in measured], axis=0),
        covariance_M=np.mean([one.point.covariance_M for one in measured], axis=0) / n,
    )
    rotations = [one.angle_M for one in measured if one.angle_M is not None]
    return replace(
        first,
        angle_M=np.mean(rotations, axis=0) if len(rotations) == n else None,
        q=np.mean([one.q for one in measured], axis=0),
        predicted_M=np.mean([one.predicted_M for one in measured], axis=0),
        point=point,
        repeatability_m=max(first.repeatability_m, scatter_m) / math.sqrt(n),
    )


Rest = Mapping[str, Measured]
"""Arm -> its measurement, with all arms of a target at rest; without arms whose SMR could not be measured."""


@dataclass
class Findings:
    """Measurements and problems at one target.

    Attributes
    ----------
    commands : mapping
        Arm -> command.
    corrected : bool
        Whether remaining errors were to be corrected.
    driven : mapping
        Arm -> joint positions (N,) [rad] sent from the model without correction, and signs (N,) of the last motions.
    nominal : mapping
        Measurements with the nominal commands.
    rounds : list
        Measurements without correction, then after each correction.
    best : int
        Index of the round whose commands are kept.
    notes : mapping
        Arm -> what went wrong.
    lost : mapping
        Arm -> why its SMR was not found where it should be.
    """

    commands: Mapping[str, Command]
    corrected: bool = False
    driven: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    nominal: Rest = field(default_factory=dict)
    rounds: list[Rest] = field(default_factory=list)
    best: int = 0
    notes: dict[str, str] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)

    def note(self, names: Sequence[str], text: str) -> None:
        """Add a note to some arms, unless they have it already."""
        for name in names:
            before = self.notes.get(name, "")
            if text not in before:
                self.notes[name] = f"{before}; {text}" if before else text

    def contradictions(self) -> dict[str, str]:
        """Return arm -> why its measurements contradict the model, empty if they do not; only arms with measurements.

        Corrected rounds do not count: they are made to meet the target, not the model.
        """
        found = {}
        for name, command in self.commands.items():
            measured = [rest[name] for rest in (self.nominal, *self.rounds[:1]) if name in rest]
            if measured or name in self.lost:
                found[name] = disagreement(measured, command.record.within_mm) if measured else self.lost[name]
        return found

    def targets(self, judge: Judge) -> list[MeasuredTarget]:
        """Return the result of each arm."""
        return [self._target(command, judge) for command in self.commands.values()]

    def pair(self, judge: Judge) -> MeasuredPair | None:
        """Return the result of both arms together; None if the target is of one arm."""
        if len(self.commands) != 2:
            return None
        names = list(self.commands)
        first, second = self.commands.values()
        wanted_mm = None
        if first.expected_M is not None and second.expected_M is not None:
            wanted_mm = float(np.linalg.norm(second.expected_M - first.expected_M)) * 1e3

        def off_mm(rest: Rest) -> float | None:
            return abs(distance_error_m(rest[names[0]], rest[names[1]])) * 1e3 if len(rest) == 2 else None

        notes = [note if note.startswith("arm") else f"arm {name}: {note}" for name, note in self.notes.items()]
        rounds_mm = [off_mm(rest) for rest in self.rounds]
        kept_mm = rounds_mm[self.best] if rounds_mm else None
        expanded = None if kept_mm is None else self._expanded_mm(self.rounds[self.best], judge)
        return MeasuredPair.like(
            first.target,
            wanted_mm=wanted_mm,
            nominal_mm=off_mm(self.nominal),
            compensated_mm=rounds_mm[0] if rounds_mm else None,
            expanded_mm=expanded,
            verdict=judge.verdict(kept_mm, expanded, first.target.tolerance_mm),
            rounds_mm=tuple(off for off in rounds_mm if off is not None) if self.corrected else (),
            corrected_mm=rounds_mm[self.best] if self.best else None,
            note="; ".join(dict.fromkeys(notes)),
            relative=self._relative(expanded, judge),
        )

    def _relative(self, expanded_mm: float | None, judge: Judge) -> MeasuredRelative | None:
        """Return the errors of the second flange's pose in the first one's frame; None if they were not measured.

        ``expanded_mm`` is that of the distance; a lever adds the uncertainty of the first flange's rotation.
        """
        first, second = (one.record for one in self.commands.values())
        kept = self.rounds[self.best] if self.rounds else {}
        off = [_relative_error(rest, first.arm, second.arm) for rest in (self.nominal, *self.rounds[:1], kept)]
        if len(off) < 3 or off[1] is None or off[2] is None:
            return None
        (nominal_mm, nominal_mrad), (mm, mrad) = off[0] or (None, None), off[2]
        stated, expanded = (first.orientation, second.orientation), None
        if stated[0] is not None and stated[1] is not None:
            budgets = [
                angle_budget(judge.profile, one.arm, rotation.model_mrad, rotation.noise_mrad)
                for one, rotation in ((first, stated[0]), (second, stated[1]))
            ]
            expanded, lever = expanded_mrad([*budgets[0], *budgets[1]]), expanded_mrad(budgets[0])
            apart_m = float(np.linalg.norm(kept[second.arm].point.p_M - kept[first.arm].point.p_M))
            if expanded_mm is not None:
                expanded_mm = None if lever is None else math.hypot(expanded_mm, apart_m * lever)
        return MeasuredRelative.like(
            second.relative,
            nominal_mm=nominal_mm,
            compensated_mm=off[1][0],
            final_mm=mm,
            expanded_mm=expanded_mm,
            position_verdict=judge.verdict(mm, expanded_mm, first.tolerance_mm),
            nominal_mrad=nominal_mrad,
            compensated_mrad=off[1][1],
            final_mrad=mrad,
            expanded_mrad=expanded,
            verdict=judge.verdict(mrad, expanded, first.orientation_tolerance_mrad),
        )

    def _expanded_mm(self, rest: Rest, judge: Judge) -> float | None:
        """Return the expanded uncertainty [mm] of an arm's error, or of the distance error of two arms."""
        parts = {name: one.record.parts for name, one in self.commands.items()}
        return judge.expanded_mm({name: one.point.p_M for name, one in rest.items()}, parts)

    def _target(self, command: Command, judge: Judge) -> MeasuredTarget:
        target, name = command.target, command.record.arm
        rounds = [rest[name] for rest in self.rounds if name in rest]
        alone, kept = (rounds[0], rounds[self.best]) if rounds else (None, None)
        nominal = self.nominal.get(name)
        corrected = kept if self.best else None
        expanded = None if kept is None else self._expanded_mm({name: kept}, judge)
        sent, came = self.driven.get(name, (None, None))
        return MeasuredTarget(
            **dict(target_record(target, name)),
            nominal_mm=_error_mm(nominal),
            compensated_mm=_error_mm(alone),
            note=self.notes.get(name, ""),
            expanded_mm=expanded,
            verdict=judge.verdict(_error_mm(kept), expanded, target.tolerance_mm),
            wanted_M=_point(None if alone is None else alone.wanted_M),
            predicted_M=_point(None if alone is None else alone.predicted_M),
            measured_M=_point(None if alone is None else alone.point.p_M),
            q=None if alone is None else tuple(alone.q.tolist()),
            within_mm=command.record.within_mm,
            rounds_mm=tuple(one.error_m * 1e3 for one in rounds) if self.corrected else (),
            corrected_mm=_error_mm(corrected),
            q_corrected=None if corrected is None else tuple(corrected.sent.tolist()),
            q_driven=None if sent is None else tuple(sent.tolist()),
            approach=None if came is None else tuple(int(sign) for sign in came),
            orientation=_rotation(command, nominal, alone, kept, judge),
        )


def _rotation(
    command: Command, nominal: Measured | None, alone: Measured | None, kept: Measured | None, judge: Judge
) -> MeasuredRotation | None:
    """Return the rotation errors of the flange; None if none was measured."""
    angles = [_rotation_mrad(one) for one in (nominal, alone, kept)]
    if all(angle is None for angle in angles):
        return None
    record, expanded = command.record, None
    stated = record.orientation
    if stated is not None:
        expanded = expanded_mrad(angle_budget(judge.profile, record.arm, stated.model_mrad, stated.noise_mrad))
    return MeasuredRotation.like(
        stated,
        nominal_mrad=angles[0],
        compensated_mrad=angles[1],
        final_mrad=angles[2],
        expanded_mrad=expanded,
        verdict=judge.verdict(angles[2], expanded, record.orientation_tolerance_mrad),
    )


def _rotation_mrad(measured: Measured | None) -> float | None:
    return None if measured is None or measured.angle_M is None else float(np.linalg.norm(measured.angle_M)) * 1e3


def _relative_error(rest: Rest, first: str, second: str) -> tuple[float, float | None] | None:
    """Return by how much the second SMR [mm] and flange [mrad] are off, seen from the first flange.

    None without both measurements or the first flange's rotation; no angle without the second one's.
    """
    if len(rest) != 2 or (angle_M := rest[first].angle_M) is None:
        return None
    back, other_M = rotation_from_vector(-angle_M), rest[second].angle_M
    seen = rest[second].point.p_M - rest[first].point.p_M
    off_mm = float(np.linalg.norm(back @ seen - (rest[second].wanted_M - rest[first].wanted_M))) * 1e3
    if other_M is None:
        return off_mm, None
    return off_mm, float(np.linalg.norm(rotation_vectors((back @ rotation_from_vector(other_M))[None]))) * 1e3


def measured_rotation(arm: ArmModel, point: Point, wanted_M: Array | None) -> Array | None:
    """Return the rotation vector (3,) [rad] in the tracker frame from the wanted to the measured flange rotation.

    None if no orientation was measured, if ``wanted_M`` (3, 3) is None or NaN (any rotation will do), or if the probe's
    mounting is unknown because the readings had no orientations.
    """
    if point.quaternion_M is None or wanted_M is None or arm.geometry.probe is None or np.isnan(wanted_M).any():
        return None
    R_M_F = rotations_of(point.quaternion_M) @ rotation_from_vector(arm.geometry.probe).T
    return np.asarray(rotation_vectors((R_M_F @ wanted_M.T)[None])[0])


def _error_mm(measured: Measured | None) -> float | None:
    return None if measured is None else measured.error_m * 1e3


def _point(p_M: Array | None) -> tuple[float, float, float] | None:
    """Return a point for JSON; None if it is None or not finite."""
    if p_M is None or not np.isfinite(p_M).all():
        return None
    return xyz_of(p_M)


def predict_at_rest(model: CellModel, mover: Mover, name: str, state: ArmState, point: PointAtRest) -> Array:
    """Predict the SMR position of an arm (3,) [m] with the calibrated model at the joint positions that it reached.

    The conditions are those of this stop: approach, step, rest, payload, temperatures, position of the other arm. The
    time is now.
    """
    carried = mover.profile.arms[name].payload
    known = state.payload_kg is not None and abs(state.payload_kg - carried.mass) <= SAME_PAYLOAD_KG
    conditions = replace(
        mover.conditions(name, state, -0.5 * point.averaging_s),
        payload_center_F=np.array([carried.center_of_mass]) if known else None,
        air_c=None if point.temperature_c is None else np.array([point.temperature_c]),
    )
    return np.asarray(model.arms[name].predict(point.q[None], beside(model, name, conditions, mover.other_q(name)))[0])


def distance_error_m(first: Measured, second: Measured) -> float:
    """Return measured minus wanted distance between two SMRs [m]."""
    measured = np.linalg.norm(first.point.p_M - second.point.p_M)
    return float(measured - np.linalg.norm(first.wanted_M - second.wanted_M))


def rms_error_m(rest: Rest) -> float:
    """Return the root mean square over the arms of their distances from the target [m]."""
    return float(np.sqrt(np.mean([one.error_m**2 for one in rest.values()])))


# -- agreement with the model -----------------------------------------------------------------------------------------


def disagreement(found: Sequence[Measured], within_mm: float | None) -> str:
    """Return why the measurements at one target contradict the model; empty if one of them agrees, or if no prediction
    is finite."""
    allowed_m = max(_FAR_M, _FAR_RATIO * (within_mm or 0.0) * 1e-3)
    nearest_m = min((one.unexpected_m for one in found if np.isfinite(one.unexpected_m)), default=0.0)
    if nearest_m <= allowed_m:
        return ""
    return f"measured {nearest_m * 1e3:.2f} mm from where the model expects it, at most {allowed_m * 1e3:.2f} mm fits"


@dataclass
class Agreement:
    """Counter of consecutive targets at which an arm contradicts the model, in order to end the job early."""

    _streak: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    _agreed: set[str] = field(default_factory=set)
    _latest: dict[str, str] = field(default_factory=dict)

    def add(self, contradictions: Mapping[str, str]) -> None:
        """Count one target; ``contradictions`` maps arm -> why it contradicts the model, empty if it agrees."""
        for arm, problem in contradictions.items():
            self._streak[arm] = self._streak[arm] + 1 if problem else 0
            self._latest[arm] = problem
            if not problem:
                self._agreed.add(arm)

    def broken(self, *, ended: bool = False) -> str:
        """Return why the job ends now; empty if it goes on. If the list has ``ended`` and no target agreed, one
        contradiction is enough."""
        for arm, streak in self._streak.items():
            limit = _LATER_STREAK if arm in self._agreed else 1 if ended else _FIRST_STREAK
            if streak >= limit:
                return f"arm {arm}: {self._latest[arm]}: {_WHAT_NOW}"
        return ""


# -- statistics -------------------------------------------------------------------------------------------------------


def result_of(visited: Sequence[Findings], judge: Judge, stopped: str = "", *, verify: bool) -> VerifyResult:
    """Return the result of the targets visited so far, with the rule by which their tolerances were decided.

    ``stopped`` says why others are missing.
    """
    targets = tuple(one for found in visited for one in found.targets(judge))
    pairs = tuple(pair for found in visited if verify and (pair := found.pair(judge)) is not None)
    judged = list(dict.fromkeys(one.arm for one in targets if one.tolerance_mm is not None))
    return VerifyResult(
        arms=by_arm(targets),
        targets=targets,
        pairs=pairs,
        cooperative=summary_of(pairs),
        stopped=stopped,
        rule=judge.rule,
        not_given=judge.not_given(judged) if verify else (),
    )


def by_arm(targets: Sequence[MeasuredTarget]) -> Mapping[str, ArmVerification]:
    """Return error statistics by arm, over the targets that were measured with both commands."""
    found = {}
    for name in dict.fromkeys(target.arm for target in targets):
        summary = summary_of([target for target in targets if target.arm == name])
        if summary is not None:
            found[name] = summary
    return found


def summary_of(measured: Sequence[MeasuredTarget | MeasuredPair]) -> ArmVerification | None:
    """Return error statistics over what was measured with both commands; None if nothing was."""
    both = [one for one in measured if one.nominal_mm is not None and one.compensated_mm is not None]
    if not both:
        return None
    errors_mm = [(one.nominal_mm, one.compensated_mm, one.final_mm) for one in both]
    nominal, compensated, final = np.array(errors_mm, dtype=np.float64).T * 1e-3
    return ArmVerification(
        nominal_mm=summarise(nominal),
        compensated_mm=summarise(compensated),
        corrected_mm=summarise(final) if any(one.rounds_mm for one in both) else None,
        **_angle_summaries([one.orientation for one in both]),
    )


def _angle_summaries(rotations: Sequence[MeasuredRotation | None]) -> dict[str, ErrorSummary]:
    """Return statistics of the rotations that were measured with both commands; empty without any."""
    pairs = [
        (one.nominal_mrad, one.compensated_mrad)
        for one in rotations
        if one is not None and None not in (one.nominal_mrad, one.compensated_mrad)
    ]
    if not pairs:
        return {}
    nominal, compensated = np.array(pairs, dtype=np.float64).T * 1e-3
    return {"nominal_mrad": summarise(nominal), "compensated_mrad": summarise(compensated)}
