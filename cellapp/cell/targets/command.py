"""Command of an arm for one target, with its prediction."""

from __future__ import annotations

from dataclasses import dataclass

from cellapp.cell.targets.ranges import conditions_of, holds_for
from cellapp.cell.targets.records import PredictedTurn, TargetCommand, UnknownCondition
from cellapp.cell.targets.targets import Target, target_record
from cellapp.estimation.uncertainty.records import ToleranceVerdict, UncertaintyParts
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Prediction:
    """Uncertainty of the SMR's position at a command. Distances in mm, for people.

    Attributes
    ----------
    uncertainty_mm : float
        Standard uncertainty of a measured coordinate, with all parts.
    parts : UncertaintyParts
    within_mm : float
        Distance from the target that a measurement does not exceed with 95 % probability; with the same parts.
    unknown : tuple of UnknownCondition
    verdict : str
        Verdict against the tolerance.
    """

    uncertainty_mm: float
    parts: UncertaintyParts
    within_mm: float
    unknown: tuple[UnknownCondition, ...]
    verdict: ToleranceVerdict


@dataclass(frozen=True, eq=False)
class Command:
    """Joint positions to send for one target.

    Attributes
    ----------
    target : Target
    arm : str
        Arm; a cooperative target has one command for each of its arms.
    q_nominal, q_compensated : array, shape (N,), or None
        Joint positions [rad] from the published and from the calibrated model, the latter for joints that arrive from
        ``side``; None if the target was refused.
    expected_M, nominal_M : array, shape (3,), or None
        Expected measurement of the SMR [m]: the target relative to the calibrated and to the nominal base.
    refusal : str
        Why the target is not commanded; empty if it is.
    branches : int or None
        Number of inverse solutions within the joint limits.
    visible : bool or None
        Whether the tracker sees the SMR at the compensated command.
    residual_um, residual_urad : float or None
        Distance and angle by which the calibrated model misses the target; the angle is None if it is free.
    note : str
        What to know about a command that is not refused.
    conditions : MeasurementConditions or None
        Working conditions that the command was computed for (one row), including the side of approach.
    side : signs or None
        Sign of each joint's last motion that the command is for: as stated, else, if it matters, as on the way from
        home; None if any side will do.
    payload_kg : float or None
        Payload that the command was computed for, stated or the profile's.
    prediction : Prediction or None
        None if the model states no uncertainty.
    turn : PredictedTurn or None
        None if no orientation of the arm was measured.
    rotation_M, nominal_rotation_M : array, shape (3, 3), or None
        Rotation of the flange at ``expected_M`` and ``nominal_M``; NaN if any will do.
    """

    target: Target
    arm: str
    q_nominal: Array | None
    q_compensated: Array | None
    expected_M: Array | None
    nominal_M: Array | None
    refusal: str
    branches: int | None = None
    visible: bool | None = None
    residual_um: float | None = None
    residual_urad: float | None = None
    note: str = ""
    conditions: MeasurementConditions | None = None
    side: tuple[int, ...] | None = None
    payload_kg: float | None = None
    prediction: Prediction | None = None
    turn: PredictedTurn | None = None
    rotation_M: Array | None = None
    nominal_rotation_M: Array | None = None

    @property
    def uncertainty_mm(self) -> float | None:
        """Standard uncertainty [mm] of a measured coordinate; None if the model states none."""
        return None if self.prediction is None else self.prediction.uncertainty_mm

    @property
    def within_mm(self) -> float | None:
        """Distance [mm] from the target that a measurement does not exceed with 95 % probability; None if unknown."""
        return None if self.prediction is None else self.prediction.within_mm

    @property
    def approach(self) -> tuple[int, ...] | None:
        """Side of each joint that the target states; None if it states none."""
        return self.target.approach if self.arm == self.target.arm else None


def refused(target: Target, arm: str, refusal: str, branches: int | None = None) -> Command:
    """Return the command of a refused target, with the reason."""
    return Command(target, arm, None, None, None, None, refusal, branches)


def command_record(command: Command) -> TargetCommand:
    """Return a command as a result record."""
    target, found = command.target, command.prediction
    judged: ToleranceVerdict = "" if command.refusal or target.tolerance_mm is None else "cannot say"
    return TargetCommand.like(
        command,
        **dict(target_record(target, command.arm)),
        q_nominal=None if command.q_nominal is None else tuple(command.q_nominal.tolist()),
        q_compensated=None if command.q_compensated is None else tuple(command.q_compensated.tolist()),
        parts=None if found is None else found.parts,
        unknown=() if found is None else found.unknown,
        approach=command.side,
        holds_for="" if command.q_compensated is None else _holds_for(command),
        verdict=judged if found is None else found.verdict,
        orientation=command.turn,
    )


def _holds_for(command: Command) -> str:
    """Return what the compensated command is valid for: sides, payload, and conditions that its target states."""
    stated = conditions_of(command.target, command.arm)
    words = []
    if stated.temperature is not None:
        words.append(f"{stated.temperature:g} degC")
    if stated.time is not None:
        words.append(f"{stated.time:g} s after the run began")
    if stated.dwell is not None:
        words.append(f"{stated.dwell:g} s at rest")
    return holds_for(command.side, payload_kg=command.payload_kg, stated=words)
