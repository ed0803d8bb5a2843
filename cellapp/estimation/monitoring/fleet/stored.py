"""The parts of stored results and models that a comparison of many runs needs; all other keys are passed over."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict, Field

from cellapp.estimation.discovery.records import Place
from cellapp.estimation.monitoring.check.records import CheckVerdict
from cellapp.estimation.uncertainty.records import Characteristic, Conformity
from cellapp.ground.results import Estimate, Method, Stage


class Part(BaseModel):
    """A part of a stored result."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class Errors(Part):
    """As ``ErrorSummary`` [mm]."""

    mean: float
    rms: float
    std: float
    max: float
    n: int


class StageErrorsPart(Part):
    """Held-out errors of one model."""

    position_mm: Errors


class RepeatabilityPart(Part):
    """ISO 9283 repeatability [mm] of ``n`` repeated stops."""

    rp: float
    n: int


class CalibratedArm(Part):
    """One arm of a calibration."""

    identified: Mapping[str, object]
    merged: Mapping[str, Mapping[str, float]]
    degrees_of_freedom: int
    repeatability_mm: RepeatabilityPart | None = None
    prior: Mapping[str, object] | None = None
    errors: Mapping[Stage, StageErrorsPart] = Field(default={}, alias="validate")


class TransformEstimate(Part):
    """A parameter of the transform."""

    value: float
    standard_error: float | None
    unit: str


class PairMethod(Part):
    """What one method says of the pair."""

    identified: Mapping[str, TransformEstimate] = {}


class Calibrated(Part):
    """A calibration."""

    arms: Mapping[str, CalibratedArm]
    pair: Mapping[Method, PairMethod] = {}


class BeforeAfterPart(Part):
    """A number before and after."""

    before: float
    after: float


class EvidencePart(Part):
    """Held-out rms error without and with an effect [mm]."""

    heldout_mm: BeforeAfterPart


class AcceptedPart(Part):
    """An accepted effect."""

    effect: str
    title: str
    where: Place
    parameters: Mapping[str, Estimate]
    evidence: EvidencePart
    answer_set: tuple[str, ...] = ()
    description: Mapping[str, object] | None = None


class SmallestPart(Part):
    """The smallest value that would have been found."""

    value: float


class AbsentPart(Part):
    """An effect that was not found, or that could not be seen."""

    effect: str
    smallest_seen: Mapping[str, SmallestPart] | None = None


class NoisePart(Part):
    """Rms length of the noise of a measured position [mm]."""

    rms: float


class SearchedArm(Part):
    """One arm of a discovery."""

    accepted: tuple[AcceptedPart, ...]
    not_found: tuple[AbsentPart, ...] = ()
    invisible: tuple[AbsentPart, ...] = ()
    noise_mm: NoisePart | None = None
    errors: Mapping[Stage, StageErrorsPart] = Field(default={}, alias="validate")


class Searched(Part):
    """A discovery."""

    arms: Mapping[str, SearchedArm]
    pair: Mapping[Method, PairMethod] = {}


class VerifiedArm(Part):
    """Distances of one arm from its targets [mm]; the corrected ones are kept where there are some."""

    compensated_mm: Errors
    corrected_mm: Errors | None = None


class Verified(Part):
    """A verification."""

    arms: Mapping[str, VerifiedArm]


class CheckedArmPart(Part):
    """One arm of a check."""

    rms_mm: float | None = None
    stops: int = 0


class FoundPart(Part):
    """A change that a check found."""

    arm: str
    what: str


class Checked(Part):
    """A check."""

    verdict: CheckVerdict
    arms: Mapping[str, CheckedArmPart] = {}
    changes: tuple[FoundPart, ...] = ()


class JudgedPart(Part):
    """A judgement."""

    characteristic: Characteristic
    where: str
    value_mm: float | None
    tolerance_mm: float
    conformity: Conformity


class CharacteristicPart(Part):
    """A characteristic [mm] with its expanded uncertainty (coverage factor 2)."""

    value_mm: float
    expanded_mm: float | None = None


class PosePart(Part):
    """AP and RP at one pose."""

    accuracy: CharacteristicPart
    repeatability: CharacteristicPart


class CommandedPart(Part):
    """Tests with one kind of commands."""

    pose: tuple[PosePart, ...] = ()


class IsoArm(Part):
    """Tests of one arm by kind of commands."""

    tests: Mapping[str, CommandedPart] = {}


class IsoTests(Part):
    """Tests of ISO 9283 and their judgements."""

    arms: Mapping[str, IsoArm] = {}
    judgements: tuple[JudgedPart, ...] = ()


class ParametersPart(Part):
    """Parameters of a chain [m, rad]."""

    parameters: Mapping[str, float]


class TermPart(Part):
    """An effect of a model."""

    effect: str
    parameters: Mapping[str, Estimate]


class ModelArm(Part):
    """One arm of a stored model; ``covariance`` (p, p) is of ``identified``, geometry first."""

    geometry: ParametersPart
    nominal: ParametersPart
    identified: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...] | None = None
    effects: tuple[TermPart, ...] = ()


class Model(Part):
    """A stored model."""

    arms: Mapping[str, ModelArm]
