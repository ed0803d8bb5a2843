"""Results of ``compensate`` and ``push``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cellapp.estimation.uncertainty.records import CommonUncertainty, ToleranceVerdict, UncertaintyParts
from cellapp.ground.counting import first_few
from cellapp.ground.results import DecisionRule, ErrorSummary, Point, Record, Result


class TargetRecord(Record):
    """The target that a result is about, as it was written, and one arm's part in it.

    ``position`` [m] and ``rpy`` [rad] are in ``frame``; both are None in results of earlier versions, ``rpy`` also
    where the rotation is free. ``partner`` is the other arm of a cooperative target, which has a record of its own
    under the same name. ``definition`` is a digest of all that the target says; empty in results of earlier versions.
    """

    name: str
    arm: str
    position: tuple[float, float, float] | None = None
    rpy: tuple[float, float, float] | None = None
    tolerance_mm: float | None = None
    frame: str = "base"
    partner: str = ""
    definition: str = ""
    orientation_tolerance_mrad: float | None = None
    omitted_when_none = frozenset({"orientation_tolerance_mrad", "orientation"})


class UnknownCondition(Record):
    """A working condition that the model depends on and nobody stated: by how much the SMR may be elsewhere [mm]."""

    condition: str
    effects: tuple[str, ...]
    mm: float


class PredictedRotation(Record):
    """The rotation of the flange at one command, where readings had orientations [mrad].

    Attributes
    ----------
    nominal_mrad : float or None
        By what angle the command of the published geometry is off the target; None where any rotation will do.
    uncertainty_mrad, model_mrad, noise_mrad : float
        Standard uncertainty of a measured component of the rotation, that of the model alone, and the scatter of
        measured orientations about the model.
    within_mrad : float
        Angle from the target that a measurement keeps with 95 % probability.
    verdict : str
        Of that bound against the orientation's tolerance.
    """

    nominal_mrad: float | None
    uncertainty_mrad: float
    model_mrad: float
    noise_mrad: float
    within_mrad: float
    verdict: ToleranceVerdict = ""


class PredictedRelative(Record):
    """The pose of a partner's flange in the first one's frame at compensated commands, where both have a probe.

    ``within_mm`` and ``within_mrad`` are what a measurement of both arms keeps with 95 % probability: the distance of
    the SMR from where it should be seen from the first flange, and the angle between both flanges from the wanted one.
    ``verdict`` and ``turn_verdict`` are of these against the target's tolerances.
    """

    within_mm: float
    within_mrad: float
    verdict: ToleranceVerdict = ""
    turn_verdict: ToleranceVerdict = ""


class MeasuredRotation(Record):
    """Angle between the measured and the wanted rotation of the flange at one target [mrad].

    ``nominal_mrad``, ``compensated_mrad``, ``final_mrad``, ``within_mrad``, ``expanded_mrad`` and ``verdict`` are as
    those of the position in ``MeasuredTarget``; corrections by measuring are of the position.
    """

    nominal_mrad: float | None
    compensated_mrad: float | None
    final_mrad: float | None
    within_mrad: float | None = None
    expanded_mrad: float | None = None
    verdict: ToleranceVerdict = ""


class TargetCommand(TargetRecord):
    """Joint positions [rad] for one arm at one target with the nominal and the calibrated model, or why there are none.

    Attributes
    ----------
    refusal : str
        Why the target is not commanded; empty if it is.
    q_nominal, q_compensated : sequence or None
        None where the target was refused. The compensated one is for joints that arrive as ``approach`` says.
    branches : int or None
        Solutions of the inverse within the joint limits; one was chosen.
    visible : bool or None
        Whether the tracker sees the SMR there.
    residual_um, residual_urad : float or None
        Distance and angle by which the calibrated model misses the target at the command; no angle where it is free.
    note : str
        What to know about a command that is not refused.
    uncertainty_mm : float or None
        Standard uncertainty of a measured coordinate of the SMR, the square root of the sum of the squares of all
        ``parts``; None where the model states none.
    parts : UncertaintyParts or None
    within_mm : float or None
        Distance from the target that a measurement keeps with 95 % probability. It is made of the same parts, and
        holds for whatever the row holds for.
    unknown : sequence of UnknownCondition
        Where it names the approach: by how much the SMR is elsewhere with another side than ``approach`` says.
    approach : signs or None
        Sign of each joint's last motion that ``q_compensated`` is for, 0 where it does not matter: as the target
        states, else as on the way from home. None where any side will do.
    payload_kg : float or None
        That it is for, stated or the profile's.
    holds_for : str
        What the row holds for, in words: sides of approach, payload, and the conditions that the target states.
    verdict : str
        By the one decision rule, of an error of zero with ``within_mm`` as its uncertainty.
    orientation : PredictedRotation, optional
        Where orientations of this arm were measured.
    relative : PredictedRelative, optional
        Of the partner's command, where orientations of both arms were measured.
    """

    refusal: str
    q_nominal: tuple[float, ...] | None
    q_compensated: tuple[float, ...] | None
    branches: int | None = None
    visible: bool | None = None
    residual_um: float | None = None
    residual_urad: float | None = None
    note: str = ""
    uncertainty_mm: float | None = None
    parts: UncertaintyParts | None = None
    within_mm: float | None = None
    unknown: tuple[UnknownCondition, ...] = ()
    approach: tuple[int, ...] | None = None
    payload_kg: float | None = None
    holds_for: str = ""
    verdict: ToleranceVerdict = ""
    orientation: PredictedRotation | None = None
    relative: PredictedRelative | None = None
    omitted_when_none = TargetRecord.omitted_when_none | {"relative"}


class CompensateResult(Result, schema="cellapp-compensate"):
    """``compensate``: a command for each target; ``notes`` say where the model that was used is out of date.

    ``common`` is what the uncertainties of the targets of each arm have in common, where the model states some.
    """

    targets: tuple[TargetCommand, ...]
    notes: tuple[str, ...] = ()
    common: Mapping[str, CommonUncertainty] = {}


class MeasuredTarget(TargetRecord):
    """Distance of one arm's measured SMR from one target [mm]; None where it was not measured.

    Attributes
    ----------
    nominal_mm, compensated_mm : float or None
        With the command of the published geometry, and with that of the calibrated model alone.
    note : str
        Why something was not driven, not measured or not corrected; empty if all went well.
    wanted_M, predicted_M, measured_M : point or None
        In the tracker frame [m], with the compensated command: the target, what the calibrated model expects at the
        joint positions that were reached, and the measurement.
    q : sequence or None
        Those joint positions [rad].
    within_mm : float or None
        As in ``TargetCommand``.
    rounds_mm : sequence
        Distances after the model alone and after each correction by measuring; empty where none was asked for.
    corrected_mm, q_corrected : float and sequence, or None
        Distance and joint positions [rad] with the best correction; None where the model alone was the best.
    q_driven : sequence or None
        Joint positions [rad] that were sent for the model alone, for joints that came as ``approach`` says; None where
        it was not driven, and in results of earlier versions.
    approach : signs or None
        Sign of each joint's last motion at ``compensated_mm`` and at every correction, 0 where unknown.
    expanded_mm : float or None
        Expanded uncertainty (k = 2) of ``final_mm``; None where a contribution was not given.
    verdict : str
        Of ``final_mm`` against the tolerance, by the decision rule.
    orientation : MeasuredRotation, optional
        Where a probe on the flange measured it, and the target has a rotation.
    """

    nominal_mm: float | None
    compensated_mm: float | None
    note: str
    verdict: ToleranceVerdict = ""
    wanted_M: Point | None = None
    predicted_M: Point | None = None
    measured_M: Point | None = None
    q: tuple[float, ...] | None = None
    within_mm: float | None = None
    rounds_mm: tuple[float, ...] = ()
    corrected_mm: float | None = None
    expanded_mm: float | None = None
    q_corrected: tuple[float, ...] | None = None
    q_driven: tuple[float, ...] | None = None
    approach: tuple[int, ...] | None = None
    orientation: MeasuredRotation | None = None

    @property
    def final_mm(self) -> float | None:
        """Distance [mm] with the command that is kept: corrected, or the compensated command if there is none."""
        return self.compensated_mm if self.corrected_mm is None else self.corrected_mm


class MeasuredRelative(MeasuredRotation):
    """The measured pose of the partner's flange in the first one's frame against the wanted one.

    ``..._mm`` are of the vector to the partner's SMR, ``..._mrad`` of the angle between both flanges, None where the
    partner's rotation is free; the others are as in ``MeasuredTarget``, ``verdict`` that of the angle.
    """

    nominal_mm: float | None
    compensated_mm: float | None
    final_mm: float | None
    within_mm: float | None = None
    expanded_mm: float | None = None
    position_verdict: ToleranceVerdict = ""


class MeasuredPair(Record):
    """A cooperative target as measured: by how much the distance between both SMRs is off [mm].

    ``wanted_mm`` is the wanted distance; ``rounds_mm``, ``corrected_mm``, ``expanded_mm`` and ``verdict`` are as in
    ``MeasuredTarget``. ``relative`` is there where the first flange has a probe.
    """

    name: str
    arms: tuple[str, str]
    wanted_mm: float | None
    nominal_mm: float | None
    compensated_mm: float | None
    tolerance_mm: float | None = None
    verdict: ToleranceVerdict = ""
    rounds_mm: tuple[float, ...] = ()
    corrected_mm: float | None = None
    expanded_mm: float | None = None
    note: str = ""
    orientation_tolerance_mrad: float | None = None
    relative: MeasuredRelative | None = None
    omitted_when_none = frozenset({"orientation_tolerance_mrad", "relative"})

    @property
    def orientation(self) -> MeasuredRelative | None:
        """The angle between both flanges; None if it was not measured."""
        return None if self.relative is None or self.relative.compensated_mrad is None else self.relative

    @property
    def final_mm(self) -> float | None:
        """As in ``MeasuredTarget``."""
        return self.compensated_mm if self.corrected_mm is None else self.corrected_mm


class ArmVerification(Record):
    """Distances from targets, or errors of distances between SMRs, with nominal and with compensated commands.

    ``corrected_mm`` is of the commands that were kept after correcting; None where no correction was asked for.
    ``nominal_mrad`` and ``compensated_mrad`` are of the flange's rotation, where it was measured.
    """

    nominal_mm: ErrorSummary
    compensated_mm: ErrorSummary
    corrected_mm: ErrorSummary | None = None
    nominal_mrad: ErrorSummary | None = None
    compensated_mrad: ErrorSummary | None = None
    omitted_when_none = frozenset({"corrected_mm", "nominal_mrad", "compensated_mrad"})


class VerifyResult(Result, schema="cellapp-verify"):
    """``push``: every target, and with ``--verify`` the errors of each arm before and after compensation.

    ``rule`` is that by which tolerances were decided, ``not_given`` what is missing for an expanded uncertainty; in
    results of earlier versions errors alone were compared. ``cooperative`` summarises the pairs. ``stopped`` says why
    not all targets were visited; empty if they were. ``notes`` also say where the model that was used was out of date.
    ``common`` is as in ``CompensateResult``.
    """

    arms: Mapping[str, ArmVerification]
    targets: tuple[MeasuredTarget, ...]
    pairs: tuple[MeasuredPair, ...] = ()
    cooperative: ArmVerification | None = None
    stopped: str = ""
    rule: DecisionRule = "simple"
    not_given: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    common: Mapping[str, CommonUncertainty] = {}

    def of_arm(self, arm: str) -> list[MeasuredTarget]:
        """Return the targets of one arm."""
        return [one for one in self.targets if one.arm == arm]

    def complaints(self) -> list[str]:
        """Return why the verification failed: stopped, no improvement, or out of tolerance; empty if it did not.

        An error beyond its tolerance counts, whether or not the uncertainty proves it.
        """
        found = [self.stopped] if self.stopped else []
        for name in dict.fromkeys(target.arm for target in self.targets):
            arm = self.arms.get(name)
            if arm is None:
                found.append(f"arm {name}: no target could be measured")
            else:
                found += _no_better(f"arm {name}: the mean error at", arm)
        if self.cooperative is not None:
            found += _no_better("pairs: the mean error of the distance at", self.cooperative)
        seen = [(one, one.relative) for one in self.pairs if one.relative is not None]
        return [
            *found,
            *_out_of_tolerance("targets", self.targets),
            *_out_of_tolerance("pairs", self.pairs),
            *_named_out(
                "pairs with a tolerance, one SMR seen from the other flange,",
                "mm",
                [(one.name, off.final_mm, one.tolerance_mm, off.position_verdict) for one, off in seen],
            ),
        ]


def _no_better(subject: str, errors: ArmVerification) -> list[str]:
    if errors.compensated_mm.mean < errors.nominal_mm.mean:
        return []
    return [
        f"{subject} compensated targets is {errors.compensated_mm.mean:.3f} mm,"
        f" at uncompensated ones {errors.nominal_mm.mean:.3f} mm; do not use this calibration"
    ]


def _out_of_tolerance(what: str, measured: Sequence[MeasuredTarget | MeasuredPair]) -> list[str]:
    """Return sentences on positions and on rotations, of the flange or of one flange in the other's frame."""
    rotated = [(one, one.orientation) for one in measured if one.orientation is not None]
    return _named_out(
        f"{what} with a tolerance", "mm", [(one.name, one.final_mm, one.tolerance_mm, one.verdict) for one in measured]
    ) + _named_out(
        f"{what} with a tolerance of orientation",
        "mrad",
        [(one.name, angle.final_mrad, one.orientation_tolerance_mrad, angle.verdict) for one, angle in rotated],
    )


def _named_out(
    what: str, unit: str, judged: Sequence[tuple[str, float | None, float | None, ToleranceVerdict]]
) -> list[str]:
    """Return a sentence on what is out of tolerance, of (name, value, tolerance, verdict); empty if nothing is."""
    out = [
        (f"{name} ({value:.3f} {unit}, tolerance {limit:g} {unit})", verdict)
        for name, value, limit, verdict in judged
        if value is not None and limit is not None and (verdict == "out" or value > limit)
    ]
    if not out:
        return []
    named = first_few([words for words, _ in out])
    undecided = sum(verdict != "out" for _, verdict in out)
    proven = f" ({undecided} of these not proven with the uncertainty)" if undecided else ""
    total = sum(verdict != "" for *_, verdict in judged)
    return [f"{len(out)} of {total} {what} are out of it: {', '.join(named)}{proven}"]
