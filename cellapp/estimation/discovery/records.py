"""Result of ``discover``, with proposed stops."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import AliasChoices, BeforeValidator, Field

from cellapp.estimation.calibration.records import CalibrateResult, PairMethodResult
from cellapp.ground.results import Estimate, Method, Record, Result, Stage, StageErrors, Verdict
from cellapp.robot.effects.effect import Meaning

StructureKind = Literal["joints", "order", "time", "approach", "position", "tracker"]


class BeforeAfter(Record):
    """A number before and after; ``before`` is NaN, null in JSON, where it could not be computed."""

    before: Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
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
    """Where an effect acts: joints (from 1) or frames; place and variables of a data-driven term."""

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
    """Another effect that explains nearly as much; ``distinguishable``: whether the data rule it out."""

    effect: str
    statistic: float
    distinguishable: bool = Field(
        validation_alias=AliasChoices("told_apart", "distinguishable"), serialization_alias="told_apart"
    )


class PlaceMovement(Record):
    """Rms displacement of the SMR [mm] at the readings by one joint or frame ``where``, and the parameters of it."""

    where: str
    parameters: tuple[str, ...]
    moves_mm: float


class CycleBand(Record):
    """Middle 80 % of the power of a periodic error in cycles per revolution, its strongest line, and its rms."""

    first: int = Field(validation_alias="from", serialization_alias="from")
    last: int = Field(validation_alias="to", serialization_alias="to")
    peak: int
    rms_urad: float
    rms_standard_error_urad: float | None = None
    omitted_when_none = frozenset({"rms_standard_error_urad"})


class TermDescription(Record):
    """A data-driven term in words and, where one fits as well, as a formula (empty where none does)."""

    channel: str
    variables: tuple[str, ...]
    size_um: float
    formula: str
    sentence: str


class AcceptedEffect(Record):
    """An effect that discovery added to the model, with its evidence.

    ``posterior`` is the probability that it is there; None where it was not computed. ``parameters`` are those of its
    law. ``law_misfit`` is the rms displacement of the SMR by its smooth discrepancy term over that by its law, None
    where it has no discrepancy term. ``movements`` are the joints or frames it acts on, that which moves the SMR most
    first.
    """

    effect: str
    title: str
    law: LawRecord
    where: Place
    parameters: Mapping[str, Estimate]
    evidence: Evidence
    runners_up: tuple[RunnerUp, ...]
    posterior: float | None = None
    law_misfit: float | None = None
    meaning: Meaning | None = None
    cycles: Mapping[str, CycleBand] | None = None
    movements: tuple[PlaceMovement, ...] | None = None
    description: TermDescription | None = None
    omitted_when_none = frozenset({"cycles", "movements", "description"})

    @property
    def indistinguishable(self) -> tuple[str, ...]:
        """Effects that would explain these data as well."""
        return tuple(alternative.effect for alternative in self.runners_up if not alternative.distinguishable)

    @property
    def answer_set(self) -> tuple[str, ...]:
        """The effect and those that would explain these data as well: one of them is there."""
        return (self.effect, *self.indistinguishable)

    @property
    def ruled_out(self) -> tuple[str, ...]:
        """Effects nearly as good that these data rule out."""
        return tuple(alternative.effect for alternative in self.runners_up if alternative.distinguishable)


class SmallestSize(Record):
    """The smallest value of a parameter that the search would have found."""

    value: float
    unit: str


class AbsentEffect(Record):
    """An effect that was not found or that these data cannot show; sizes from which it would have been found."""

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
    """Measured and computed values of one effect in one place that it acts on, sorted by x.

    ``x`` is what the effect depends on; what is periodic in the joint angle is folded into one turn or one cycle, and
    has a ``curve``. ``measured`` are the readings less everything else in the model, ``computed`` is the effect itself,
    both in the unit of ``y_label``; ``band`` is the standard deviation of ``computed``, geometry included.
    """

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
    """Held-out position error [mm], or orientation error [mrad]."""

    mean: float
    rms: float
    median: float
    max: float


class HeldOutBeforeAfter(Record):
    """Held-out error with the geometry alone and with what was found [mm, mrad]."""

    before: HeldOutPosition
    after: HeldOutPosition


class Noise(Record):
    """Noise of a measured position: rms of its length [mm], as the readings state it or as discovery estimated it."""

    rms: float
    source: Literal["stated", "estimated"]


class StructureTest(Record):
    """p-value of the residual against one kind of structure: small where the residual still follows it."""

    against: StructureKind
    p_value: float


class RemainingStructure(Record):
    """Tests of the residual of the final model for structure, and their outcome in one sentence."""

    tests: tuple[StructureTest, ...]
    sentence: str


class MotionEffectResult(Record):
    """An effect that recordings of motion show; ``only_motion`` says why stops cannot, None where they can.

    ``at_rest``: whether it belongs into commands of poses at rest, by ``law``.
    """

    effect: str
    title: str
    joints: tuple[int, ...]
    parameters: Mapping[str, Estimate]
    evidence: Evidence
    only_motion: str | None = None
    at_rest: bool
    law: LawRecord | None = None


class MotionDiscoveryResult(Record):
    """What recordings of motion show of an arm; ``heldout_mm`` are rms errors at held-out blocks of time.

    ``used``: whether the model with these effects is the one from now on.
    """

    effects: tuple[MotionEffectResult, ...]
    heldout_mm: BeforeAfter
    used: bool
    seconds: float | None = None


class Unnamed(Record):
    """What the named effects leave, as one smooth term; ``rms_mm`` is its displacement of the SMR.

    ``acts_on`` are the places that it mostly moves, ``causes`` the effects that it looks most like. ``left_out_mm`` are
    mean errors of readings that were left out of the fit, without and with it; ``heldout_position_mm`` judges it.
    """

    rms_mm: float
    in_force: bool
    acts_on: tuple[str, ...] = ()
    causes: tuple[str, ...] = ()
    left_out_mm: BeforeAfter | None = None
    heldout_position_mm: HeldOutBeforeAfter | None = None


class ArmDiscoveryResult(Record):
    """Discovery in the data of one arm; ``heldout_mm`` are rms errors on stops that the search did not see.

    ``validate`` has the held-out errors of the model with what was found; it is empty where nothing was.
    ``scatter`` is the root of chi-square per degree of freedom of the residuals, ``omnibus_p`` its p-value.
    ``candidates`` has the posterior probability of every effect that was tested, by its slug.
    ``left_out_configurations`` are those of readings with gross errors, on which nothing here rests.
    ``heldout_orientation_mrad`` and ``noise_mrad``, the standard deviation of a component about the model, are there
    where orientations were measured. ``claim`` says where the scatter contradicts the stated uncertainty.
    """

    noise_floor_mm: float | None
    noise_mm: Noise | None = None
    noise_mrad: float | None = None
    heldout_mm: BeforeAfter
    heldout_position_mm: HeldOutBeforeAfter | None = None
    heldout_orientation_mrad: HeldOutBeforeAfter | None = None
    seconds: float | None = None
    steps: tuple[GapStep, ...]
    threshold: float
    omnibus_p: float | None
    scatter: float | None
    accepted: tuple[AcceptedEffect, ...]
    candidates: Mapping[str, float] = {}
    structure: RemainingStructure | None = None
    invisible: tuple[AbsentEffect, ...]
    not_found: tuple[AbsentEffect, ...]
    uncertainty_mm: PredictedUncertainty | None = None
    pictures: tuple[Picture, ...] = ()
    validate_: Mapping[Stage, StageErrors] = {}
    left_out_configurations: tuple[int, ...] = ()
    motion: MotionDiscoveryResult | None = None
    unnamed: Unnamed | None = None
    claim: str | None = None
    verdict: Verdict
    sentence: str
    omitted_when_none = frozenset({"heldout_orientation_mrad", "noise_mrad", "motion", "unnamed", "claim"})


class Discrimination(Record):
    """Non-centrality of the test between two models: now, with the proposed stops, with equally many random ones."""

    now: float
    proposed: float
    random: float


class ProposalQuestion(Record):
    """One question that proposed stops answer; ``against`` None asks whether the effect exists at all."""

    effect: str
    against: str | None
    needed: float
    discrimination: Discrimination
    gain_over_random: float


class ProposedStop(Record):
    """One proposed stop of one arm: joint positions, start of the last step [rad], dwell before the measurement [s]."""

    configuration: int
    arm: str
    q: tuple[float, ...]
    via: tuple[float, ...] | None
    dwell_s: float | None


class Proposal(Record):
    """Further stops that answer what discovery left open, and their predicted discrimination."""

    count: int
    written: bool
    first_configuration: int | None
    arms: Mapping[str, tuple[ProposalQuestion, ...]]
    stops: tuple[ProposedStop, ...]
    notes: tuple[str, ...]
    advice: tuple[str, ...]


class DiscoverResult(Result, schema="cellapp-discover"):
    """``discover``: every arm; ``pair`` are the cooperative errors with the effects that were found.

    ``notes`` says which effects of plug-ins could not be searched for, and why; None if there are none.
    """

    arms: Mapping[str, ArmDiscoveryResult]
    pair: Mapping[Method, PairMethodResult] = {}
    proposal: Proposal | None = None
    notes: tuple[str, ...] | None = None
    omitted_when_none = frozenset({"proposal", "notes"})


def with_effects(calibrated: CalibrateResult, found: DiscoverResult) -> CalibrateResult:
    """Add the stage ``effects`` of a discovery to a calibration, for showing them together."""
    arms = {
        name: arm
        if name not in found.arms
        else arm.model_copy(update={"validate_": {**arm.validate_, **found.arms[name].validate_}})
        for name, arm in calibrated.arms.items()
    }
    return calibrated.model_copy(update={"arms": arms, "pair": {**calibrated.pair, **found.pair}})


class PlannedAccuracy(Record):
    """Standard errors that measurements at the planned stops give, with ``scatter_mm`` beside the tracker's noise.

    ``standard_error_mm`` is the root mean square over the planned stops of the standard uncertainty of a predicted SMR
    position, ``largest_mm`` its largest value; ``parameters`` are nominal values with their standard errors.
    """

    scatter_mm: float
    standard_error_mm: float
    largest_mm: float
    parameters: Mapping[str, Estimate]


class PlannedEffect(Record):
    """Whether a plan can show an effect, and from which sizes on, where noise is the tracker's alone.

    ``smallest_seen`` is by parameter; ``smallest_seen_rms_mm`` the rms displacement of the SMR by the smallest of them,
    ``with_scatter_rms_mm`` the same with the scatter of arms before anything is known of it.
    """

    effect: str
    visible: bool
    reason: str
    visible_share: float | None = None
    smallest_seen: Mapping[str, SmallestSize] = {}
    smallest_seen_rms_mm: float | None = None
    with_scatter_rms_mm: float | None = None
