"""Typed, versioned results of the verbs: the one door to and from JSON.

Every verb returns one of the objects below; ``to_json`` writes what ``--json`` prints and what the run file keeps,
``from_json`` reads it back. Key names are a contract with other programs. Lengths whose key ends in ``_mm`` are
millimetres, all others are SI units.

Results of trials derive from ``Result`` too and stand beside their trial.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, ValidationError, model_serializer

from cellapp.errors import InputError

Stage = Literal["nominal", "geometry", "network", "effects"]
STAGES: tuple[Stage, ...] = ("nominal", "geometry", "network", "effects")
"""Models of one arm in the order in which they are built."""

Method = Literal["nominal", "method_1", "method_2", "proposed", "effects"]
METHODS: tuple[Method, ...] = ("nominal", "method_1", "method_2", "proposed", "effects")
"""Models of the pair; method 1, method 2 and proposed are those of Bai et al., ROBOT 45(3), 2023."""

Verdict = Literal["explained", "nothing missing", "unknown effect", "ambiguous"]

StageName = Literal["calibrate", "discover", "compensate", "push", "verify"]
CALIBRATE: StageName = "calibrate"
DISCOVER: StageName = "discover"
COMPENSATE: StageName = "compensate"
PUSH: StageName = "push"
"""Targets that were pushed without measuring them; it does not replace a verification."""
VERIFY: StageName = "verify"
STAGE_NAMES: tuple[StageName, ...] = (CALIBRATE, DISCOVER, COMPENSATE, PUSH, VERIFY)
"""What verbs store in a run, in the order of the work."""


class Record(BaseModel):
    """A part of a result: immutable, rejects unknown keys. NaN and infinity become null in JSON."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        ser_json_inf_nan="null",
        populate_by_name=True,
        alias_generator=lambda name: name.removesuffix("_"),  # schema_ and validate_ would hide names of pydantic
    )

    omitted_when_none: ClassVar[frozenset[str]] = frozenset()
    """Keys that are left out of the JSON object where their value is None."""

    @model_serializer(mode="wrap")
    def _without_omitted(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        content: dict[str, Any] = handler(self)
        return {key: value for key, value in content.items() if value is not None or key not in self.omitted_when_none}


class Result(Record):
    """The result of one verb. Subclasses set ``schema_`` and ``version`` to literals."""

    schema_: str
    version: int

    def as_object(self) -> dict[str, Any]:
        """The JSON object as plain data."""
        content: dict[str, Any] = json.loads(self.to_json())
        return content

    def to_json(self, *, indent: int | None = None) -> str:
        """The JSON text; floats are written in their shortest exact form."""
        return self.model_dump_json(by_alias=True, indent=indent)

    @classmethod
    def from_json(cls, text: str, where: str) -> Self:
        """Read what ``to_json`` wrote.

        Raises
        ------
        InputError
            If the text is not such a result; the message begins with ``where``.
        """
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            key = ".".join(str(part) for part in first["loc"])
            raise InputError(
                f"{where}: {key or 'text'}: {first['msg']}; another version of cellapp wrote it, repeat that step"
            ) from None


# -- parts that several results share ---------------------------------------------------------------------------------


class ErrorSummary(Record):
    """Statistics of n error magnitudes [mm]; ``mean_ci95`` is a bootstrap 95 % interval of the mean."""

    mean: float
    rms: float
    std: float
    max: float
    p50: float | None = None
    p95: float | None = None
    mean_ci95: tuple[float, float] | None = None
    n: int
    omitted_when_none = frozenset({"p50", "p95", "mean_ci95"})


class StageErrors(Record):
    """Held-out errors of one model of an arm: absolute, and ISO 9283 distance errors of all pairs of points."""

    position_mm: ErrorSummary
    distance_mm: ErrorSummary | None = None
    omitted_when_none = frozenset({"distance_mm"})


class Estimate(Record):
    """An estimated parameter with its standard error, both in ``unit``."""

    value: float
    standard_error: float | None
    unit: str


class Provenance(Record):
    """Which program made a result, from which profile, when (ISO 8601, UTC)."""

    profile: str
    seed: int
    program: str
    python: str | None = None
    numpy: str | None = None
    torch: str | None = None
    written: str
    omitted_when_none = frozenset({"python", "numpy", "torch"})


# -- plan, collect, import, export ------------------------------------------------------------------------------------


class PlanResult(Result):
    """``plan``: number of planned stops of each arm."""

    schema_: Literal["cellapp-plan"] = "cellapp-plan"
    version: Literal[1] = 1
    run: str
    stops: Mapping[str, int]


class CollectResult(Result):
    """``collect``: number of stored stops, and notes for the operator."""

    schema_: Literal["cellapp-collect"] = "cellapp-collect"
    version: Literal[1] = 1
    stops: int
    notes: tuple[str, ...]


class ImportResult(Result):
    """``import``: number of readings of each arm."""

    schema_: Literal["cellapp-import"] = "cellapp-import"
    version: Literal[1] = 1
    run: str
    readings: Mapping[str, int]
    notes: tuple[str, ...]


class ExportResult(Result):
    """``export``: the files that were written.

    ``ur_lost_rms_mm`` maps each arm to the rms position error of UR's D-H deltas, which lack the Hayati angles.
    """

    schema_: Literal["cellapp-export"] = "cellapp-export"
    version: Literal[1] = 1
    csv: str | None = None
    readings: Mapping[str, int] | None = None
    geometry: str | None = None
    ur_lost_rms_mm: Mapping[str, float] | None = None
    omitted_when_none = frozenset({"csv", "readings", "geometry", "ur_lost_rms_mm"})


class Finding(Record):
    """One check of the doctor."""

    subject: str
    status: Literal["ok", "warning", "failed"]
    text: str


class DoctorResult(Result):
    """``doctor``: what was checked."""

    schema_: Literal["cellapp-doctor"] = "cellapp-doctor"
    version: Literal[1] = 1
    findings: tuple[Finding, ...]


# -- calibrate --------------------------------------------------------------------------------------------------------


class Scatter(Record):
    """Root of chi-square per degree of freedom; ``meaning`` says against what."""

    value: float
    meaning: str


class NetworkTrial(Record):
    """A network shape that was compared on left-out folds of the training split."""

    inputs: Literal["sincos", "angles"]
    hidden: tuple[int, ...]
    turning: bool = False
    left_out_rms_mm: float


class NetworkResult(Record):
    """How the residual network was trained; ``without_rms_mm`` is the left-out error without any network."""

    used: bool
    inputs: Literal["sincos", "angles"]
    hidden: tuple[int, ...]
    turning: bool = False
    left_out_rms_mm: float
    without_rms_mm: float
    tried: tuple[NetworkTrial, ...] = ()


class Repeatability(Record):
    """Position repeatability of repeated stops [mm]: mean distance from the barycentre, and RP of ISO 9283."""

    mean: float
    rp: float
    n: int


class ArmCalibrationResult(Record):
    """Calibration of one arm.

    ``identified`` are the parameters of the geometry, ``rank`` their number, ``merged`` maps each dropped parameter to
    those that take its place and their shares. ``excess_mm`` is the scatter of a coordinate beyond the stated
    uncertainty, ``tracker_mm`` the rms length of the stated noise.
    """

    identified: Mapping[str, Estimate]
    rank: int
    parameter_set: str
    merged: Mapping[str, Mapping[str, float]]
    iterations: int
    converged: bool
    message: str
    condition: float | None
    observability: Mapping[str, float | None]
    scatter: Scatter
    excess_mm: float | None = None
    degrees_of_freedom: int
    splits: Mapping[str, int]
    tracker_mm: float | None = None
    repeatability_mm: Repeatability | None = None
    network: NetworkResult | None = None
    validate_: Mapping[Stage, StageErrors]

    @property
    def best_stage(self) -> Stage:
        """The last stage that was computed."""
        return next(stage for stage in reversed(STAGES) if stage in self.validate_)


class PairEstimate(Estimate):
    """A parameter of the inter-base transform; ``by_tracker`` is its value from the common tracker frame."""

    by_tracker: float | None = None


class PairHeldOut(Record):
    """Errors of each held-out stop [mm]: cooperative, and absolute by arm."""

    configuration: tuple[int, ...]
    cooperative_mm: tuple[float, ...]
    position_mm: Mapping[str, tuple[float, ...]]


class PairMethodResult(Record):
    """Cooperative errors of one method on held-out stops, with the transform that the profile chose and with both."""

    cooperative_mm: ErrorSummary
    transform: str | None = None
    by_transform_mm: Mapping[str, ErrorSummary] = {}
    identified: Mapping[str, PairEstimate] = {}
    iterations: int | None = None
    converged: bool | None = None
    splits: Mapping[str, int] = {}
    held_out: PairHeldOut | None = None


class CalibrateResult(Result):
    """``calibrate``: every arm, the pair by method, notes."""

    schema_: Literal["cellapp-calibrate"] = "cellapp-calibrate"
    version: Literal[1] = 1
    arms: Mapping[str, ArmCalibrationResult]
    pair: Mapping[Method, PairMethodResult]
    notes: tuple[str, ...]
    provenance: Provenance

    def with_effects(self, found: DiscoverResult) -> CalibrateResult:
        """This result with the stage ``effects`` of a discovery beside the others, for showing them together."""
        arms = {
            name: arm
            if name not in found.arms
            else arm.model_copy(update={"validate_": {**arm.validate_, **found.arms[name].validate_}})
            for name, arm in self.arms.items()
        }
        return self.model_copy(update={"arms": arms, "pair": {**self.pair, **found.pair}})

    def without_effects(self) -> CalibrateResult:
        """This result without the stage ``effects``, which older versions wrote into it."""
        arms = {
            name: arm.model_copy(update={"validate_": {k: v for k, v in arm.validate_.items() if k != "effects"}})
            for name, arm in self.arms.items()
        }
        pair = {method: entry for method, entry in self.pair.items() if method != "effects"}
        return self.model_copy(update={"arms": arms, "pair": pair})


# -- discover ---------------------------------------------------------------------------------------------------------


class BeforeAfter(Record):
    """A number before and after."""

    before: float
    after: float


class GapStep(Record):
    """Held-out rms error after one step of the search."""

    what: str
    effect: str
    heldout_mm: float


class LawRecord(Record):
    """The law by which an effect acts, with its constants."""

    name: str
    constants: Mapping[str, float]


class Place(Record):
    """Where an effect acts: joints (from 1) or frames; channel and variables of a data-driven term."""

    joints: tuple[int, ...]
    acts_on: tuple[str, ...]
    channel: str | None = None
    variables: tuple[str, ...] | None = None
    omitted_when_none = frozenset({"channel", "variables"})


class Evidence(Record):
    """Score, p-value corrected for the whole search, held-out rms error without and with the effect."""

    statistic: float
    corrected_p: float
    heldout_mm: BeforeAfter


class RunnerUp(Record):
    """Another effect that explains nearly as much; ``told_apart`` says whether these data rule it out."""

    effect: str
    statistic: float
    told_apart: bool


class Correlation(Record):
    """The geometric parameter that an effect is most correlated with."""

    parameter: str
    correlation: float


class CycleBand(Record):
    """Middle 80 % of the power of a periodic error in cycles a turn, its strongest line, and its rms."""

    first: int = Field(validation_alias="from", serialization_alias="from")
    last: int = Field(validation_alias="to", serialization_alias="to")
    peak: int
    rms_urad: float


class TermDescription(Record):
    """A data-driven term in words and, where one fits as well, as a formula (empty where none does).

    ``curve`` are points (variable, value of the term) in SI units, for terms of one variable.
    """

    channel: str
    variables: tuple[str, ...]
    size_um: float
    formula: str
    gain_over_curve: float | None
    curve: tuple[tuple[float, float], ...] = ()
    sentence: str


class AcceptedEffect(Record):
    """An effect that discovery added to the model, with its evidence."""

    effect: str
    title: str
    law: LawRecord
    where: Place
    parameters: Mapping[str, Estimate]
    evidence: Evidence
    answer_set: tuple[str, ...]
    runners_up: tuple[RunnerUp, ...]
    correlated_with: Correlation | None
    cycles: Mapping[str, CycleBand] | None = None
    description: TermDescription | None = None
    omitted_when_none = frozenset({"cycles", "description"})

    @property
    def indistinguishable(self) -> tuple[str, ...]:
        """Effects that would explain these data as well."""
        return tuple(slug for slug in self.answer_set if slug != self.effect)

    @property
    def ruled_out(self) -> tuple[str, ...]:
        """Effects nearly as good that these data rule out."""
        return tuple(rival.effect for rival in self.runners_up if rival.told_apart)


class SmallestSize(Record):
    """The smallest value of a parameter that the search would have found."""

    value: float
    unit: str


class AbsentEffect(Record):
    """An effect that was not found, or that these data cannot show, and from which size it would have been seen."""

    effect: str
    reason: str
    visible_share: float | None = None
    smallest_seen: Mapping[str, SmallestSize] | None = None
    smallest_seen_rms_mm: float | None = None
    omitted_when_none = frozenset({"visible_share"})


class CurveRecord(Record):
    """A curve at equal steps of x, with its standard deviation."""

    x: tuple[float, ...]
    value: tuple[float, ...]
    band: tuple[float, ...]


class Picture(Record):
    """Points of one effect at one place: measured with all else removed, computed, and the standard deviation."""

    title: str
    effect: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    measured: tuple[float, ...]
    computed: tuple[float, ...]
    band: tuple[float, ...] = ()
    curve: CurveRecord | None = None


class PredictedUncertainty(Record):
    """Predicted standard deviation of a coordinate over held-out configurations [mm]."""

    median: float
    largest: float


class HeldOutPosition(Record):
    """Held-out position error [mm]."""

    mean: float
    rms: float
    median: float
    max: float


class HeldOutBeforeAfter(Record):
    """Held-out position error with the geometry alone and with what was found [mm]."""

    before: HeldOutPosition
    after: HeldOutPosition


class ArmDiscoveryResult(Record):
    """Discovery in the data of one arm; ``heldout_mm`` are rms errors on stops that the search did not see.

    ``validate`` has the held-out errors of the model with what was found; it is empty where nothing was.
    ``network_mm`` is the rms correction of a residual network trained before and after the effects were added.
    ``scatter`` is the root of chi-square per degree of freedom of what is left, ``omnibus_p`` its p-value.
    """

    noise_floor_mm: float | None
    heldout_mm: BeforeAfter
    heldout_position_mm: HeldOutBeforeAfter | None = None
    seconds: float | None = None
    steps: tuple[GapStep, ...]
    threshold: float
    omnibus_p: float | None
    scatter: float | None
    accepted: tuple[AcceptedEffect, ...]
    invisible: tuple[AbsentEffect, ...]
    not_found: tuple[AbsentEffect, ...]
    network_mm: BeforeAfter | None = None
    uncertainty_mm: PredictedUncertainty | None = None
    pictures: tuple[Picture, ...] = ()
    validate_: Mapping[Stage, StageErrors] = {}
    verdict: Verdict
    sentence: str


class Discrimination(Record):
    """Non-centrality of the test between two models: now, with the proposed stops, with as many random ones."""

    now: float
    proposed: float
    random: float


class ProposalQuestion(Record):
    """One question that proposed stops shall answer; ``against`` None asks whether the effect is there at all."""

    effect: str
    against: str | None
    needed: float
    discrimination: Discrimination
    gain_over_random: float


class ProposedStop(Record):
    """One proposed stop of one arm: joint positions, start of the last leg [rad], rest before the measurement [s]."""

    configuration: int
    arm: str
    q: tuple[float, ...]
    via: tuple[float, ...] | None
    dwell_s: float | None


class Proposal(Record):
    """Further stops that would answer what discovery left open, and what they are worth."""

    count: int
    written: bool
    first_configuration: int | None
    arms: Mapping[str, tuple[ProposalQuestion, ...]]
    stops: tuple[ProposedStop, ...]
    notes: tuple[str, ...]
    advice: tuple[str, ...]


class DiscoverResult(Result):
    """``discover``: every arm; ``pair`` are the cooperative errors with the effects that were found."""

    schema_: Literal["cellapp-discover"] = "cellapp-discover"
    version: Literal[1] = 1
    arms: Mapping[str, ArmDiscoveryResult]
    pair: Mapping[Method, PairMethodResult] = {}
    proposal: Proposal | None = None
    omitted_when_none = frozenset({"proposal"})


# -- compensate, push -------------------------------------------------------------------------------------------------


class TargetCommand(Record):
    """Joint positions [rad] for one target with the nominal and with the calibrated model, or why there are none."""

    name: str
    arm: str
    refusal: str
    q_nominal: tuple[float, ...] | None
    q_compensated: tuple[float, ...] | None


class CompensateResult(Result):
    """``compensate``: a command for each target; ``notes`` say where the model that was used is out of date."""

    schema_: Literal["cellapp-compensate"] = "cellapp-compensate"
    version: Literal[1] = 1
    targets: tuple[TargetCommand, ...]
    notes: tuple[str, ...] = ()


class MeasuredTarget(Record):
    """Distance of the measured SMR from one target with either command [mm]; None where it was not measured."""

    name: str
    arm: str
    nominal_mm: float | None
    compensated_mm: float | None
    note: str


class ArmVerification(Record):
    """Distances from the targets of one arm with nominal and with compensated commands."""

    nominal_mm: ErrorSummary
    compensated_mm: ErrorSummary


class VerifyResult(Result):
    """``push``: every target, and with ``--verify`` the errors of each arm before and after compensation.

    ``notes`` also say where the model that was used was out of date.
    """

    schema_: Literal["cellapp-verify"] = "cellapp-verify"
    version: Literal[1] = 1
    arms: Mapping[str, ArmVerification]
    targets: tuple[MeasuredTarget, ...]
    notes: tuple[str, ...] = ()

    def complaints(self) -> list[str]:
        """Why the verification did not hold, arm by arm; empty if it did."""
        found = []
        for name in dict.fromkeys(target.arm for target in self.targets):
            arm = self.arms.get(name)
            if arm is None:
                found.append(f"arm {name}: no target could be measured")
            elif arm.compensated_mm.mean >= arm.nominal_mm.mean:
                found.append(
                    f"arm {name}: the mean error at compensated targets is {arm.compensated_mm.mean:.3f} mm,"
                    f" at uncompensated ones {arm.nominal_mm.mean:.3f} mm; do not use this calibration"
                )
        return found


# -- report, run ------------------------------------------------------------------------------------------------------


class RunResults(Result):
    """The current results of a run, each None where that verb has not run.

    ``calibrate`` has the stage ``effects`` of the discovery as long as that holds. ``out_of_date`` maps the name of a
    result that no longer holds to the reason. Such a result is still there, so that it can be shown with its mark; it
    is None where this version cannot read what is stored.
    """

    schema_: str = "cellapp-results"
    version: int = 1
    run: str
    calibrate: CalibrateResult | None = None
    discover: DiscoverResult | None = None
    compensate: CompensateResult | None = None
    push: VerifyResult | None = None
    verify: VerifyResult | None = None
    out_of_date: Mapping[StageName, str] = {}
    omitted_when_none = frozenset({"calibrate", "discover", "compensate", "push", "verify"})


class WholeRunResult(RunResults):
    """``run``: the folder, the results of every step, and notes for the operator."""

    schema_: Literal["cellapp-run"] = "cellapp-run"
    version: Literal[1] = 1
    notes: tuple[str, ...] = ()


class ReportResult(RunResults):
    """``report``: the page and the results that it shows."""

    schema_: Literal["cellapp-report"] = "cellapp-report"
    version: Literal[1] = 1
    page: str


# -- emulate, tracker-bridge ------------------------------------------------------------------------------------------


class EmulatedController(Record):
    """The UR controller that is emulated; ``rows`` are its D-H rows theta, d, a, alpha [rad, m, m, rad]."""

    series: str
    model: str
    serial: str
    rows: tuple[tuple[float, float, float, float], ...]
    checksums: tuple[int, ...]
    calibration_status: int


class EmulatedArm(Record):
    """An emulated arm: its controller and where that listens; ``control_port`` on 127.0.0.1 takes faults on command."""

    arm: str
    controller: EmulatedController
    host: str
    dashboard_port: int
    primary_port: int
    script_port: int
    rtde_port: int
    control_port: int


class EmulatedTracker(Record):
    """Where the tracker of the simulated cell is served over the bridge protocol."""

    host: str
    port: int


class EmulateResult(Result):
    """``emulate``: what is served; ``pace`` is simulated seconds per real second."""

    schema_: Literal["cellapp-emulate"] = "cellapp-emulate"
    version: Literal[1] = 1
    pace: float
    arms: tuple[EmulatedArm, ...]
    tracker: EmulatedTracker | None


class TrackerBridgeResult(Result):
    """``tracker-bridge``: which kind of tracker is served, where, and whether a token guards it."""

    schema_: Literal["cellapp-tracker-bridge"] = "cellapp-tracker-bridge"
    version: Literal[1] = 1
    kind: str
    host: str
    port: int | None
    serial: str | None
    guarded: bool


# -- show -------------------------------------------------------------------------------------------------------------


class ArmState(Record):
    """How much of one arm's plan is measured, and in which splits."""

    type: str
    planned: int
    measured: int
    splits: Mapping[str, int]


class StageState(Record):
    """One stored stage: when and by which version it was stored, what it rests on, and whether that still holds.

    ``number`` is 0 for results of versions that did not record a basis; ``out_of_date`` is the reason, None where the
    stage holds; ``superseded`` says that a later stage of the same name exists.
    """

    number: int
    name: StageName
    written: str
    program: str
    digest: str
    rests_on: tuple[str, ...]
    superseded: bool = False
    out_of_date: str | None = None


class OverviewResult(Result):
    """``show``: the state of a run and the command that comes next (empty if none)."""

    schema_: Literal["cellapp-overview"] = "cellapp-overview"
    version: Literal[1] = 1
    run: str
    profile: str
    arms: Mapping[str, ArmState]
    stages: tuple[StageState, ...]
    in_force: StageName | None
    next_step: str


class HistoryResult(Result):
    """``show DIR history``: every stage that was ever stored, oldest first."""

    schema_: Literal["cellapp-history"] = "cellapp-history"
    version: Literal[1] = 1
    run: str
    stages: tuple[StageState, ...]


class LogLine(Record):
    """One line of a run's log; ``written`` is UTC, ``time_s`` seconds since the run began where it was measured."""

    number: int
    written: str
    time_s: float | None
    level: str
    text: str


class LogResult(Result):
    """``show DIR log``: lines of the run's log, oldest first."""

    schema_: Literal["cellapp-log"] = "cellapp-log"
    version: Literal[1] = 1
    run: str
    lines: tuple[LogLine, ...]


class PlannedStop(Record):
    """One planned stop: joint positions of every arm [rad], whether it was measured."""

    configuration: int
    measured: bool
    q: Mapping[str, tuple[float, ...]]


class StopsResult(Result):
    """``show DIR plan``: every planned stop."""

    schema_: Literal["cellapp-stops"] = "cellapp-stops"
    version: Literal[1] = 1
    run: str
    stops: tuple[PlannedStop, ...]


VERB_RESULTS: tuple[type[Result], ...] = (
    PlanResult,
    CollectResult,
    ImportResult,
    ExportResult,
    DoctorResult,
    CalibrateResult,
    DiscoverResult,
    CompensateResult,
    VerifyResult,
    ReportResult,
    WholeRunResult,
    EmulateResult,
    TrackerBridgeResult,
    OverviewResult,
    HistoryResult,
    LogResult,
    StopsResult,
)
"""Every result of a verb, for the exported JSON schemas."""


def json_schemas(results: tuple[type[Result], ...] = VERB_RESULTS) -> dict[str, dict[str, Any]]:
    """JSON Schema (2020-12) of each result, by the name that its JSON objects carry under ``schema``.

    As ``--json`` writes NaN and infinity as null, every number may be null.
    """
    return {_schema_name(result): _nullable_numbers(result.model_json_schema()) for result in results}


def _schema_name(result: type[Result]) -> str:
    return str(result.model_fields["schema_"].default)


def _nullable_numbers(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_nullable_numbers(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    changed = {key: _nullable_numbers(part) for key, part in schema.items()}
    if changed.get("type") == "number":
        changed["type"] = ["number", "null"]
    return changed
