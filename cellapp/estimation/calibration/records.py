"""Result of ``calibrate``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from cellapp.ground.results import (
    STAGES,
    ErrorSummary,
    Estimate,
    Method,
    ModelStage,
    Provenance,
    Record,
    Result,
    Stage,
    StageErrors,
)
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.model import Inputs


class Scatter(Record):
    """Root of chi-square per degree of freedom; ``meaning`` says against what."""

    value: float
    meaning: str


class BatchesResult(Record):
    """A network from all readings in batches against the committee, on the same left-out blocks of time.

    ``committee_rms_mm`` is that without a network where the committee is not better than none; ``sigmas`` says by how
    many standard errors over the blocks the mean square is smaller. ``device`` trained it.
    """

    used: bool
    readings: int
    blocks: int
    hidden: tuple[int, ...]
    device: str
    left_out_rms_mm: float
    committee_rms_mm: float
    sigmas: float


class NetworkResult(Record):
    """How the residual network was trained; ``without_rms_mm`` is the left-out error without any network.

    ``batches`` is there where one from all readings was asked for; where it is ``used``, it is the network.
    """

    used: bool
    inputs: Inputs
    hidden: tuple[int, ...]
    turning: bool = False
    left_out_rms_mm: float
    without_rms_mm: float
    batches: BatchesResult | None = None
    omitted_when_none = frozenset({"batches"})


_MEAN_LENGTH = 2.0 * math.sqrt(2.0 / math.pi)
"""Mean length of a normal vector in three dimensions, in standard deviations of a coordinate."""


class Repeatability(Record):
    """Position repeatability of repeated stops [mm]: mean distance from the barycentre, and RP of ISO 9283."""

    mean: float
    rp: float
    n: int

    @property
    def coordinate(self) -> float:
        """Standard deviation of a coordinate [mm], if all three scatter alike."""
        return self.mean / _MEAN_LENGTH


SignaturePart = Literal["geometry", "effects", "curves"]
"""Parts of an earlier calibration of an arm: D-H rows, named effects with few parameters, smooth functions."""


class PartDrift(Record):
    """How far a part was believed: ``drift`` is the standard deviation, in ``unit``, by which each of its
    ``parameters`` may have changed since; it maximises the likelihood of the new readings. None where that is larger
    without the part."""

    parameters: int
    drift: float | None
    unit: str
    used: bool


class SignatureChange(Record):
    """A change of the arm since the earlier calibration that the new readings prove.

    ``value`` and ``standard_error`` are of the change of a single parameter, in ``unit``; ``sigmas`` is their ratio and
    ``p_value`` its chance, times the number of changes that were tested. ``evidence`` is twice the log Bayes factor
    for the change, ``moved_mm`` the rms displacement of the SMR by it; ``rivals`` are changes that explain the readings
    about as well.
    """

    what: str
    part: SignaturePart
    value: float | None = None
    standard_error: float | None = None
    unit: str = ""
    sigmas: float | None = None
    p_value: float | None = None
    evidence: float
    moved_mm: float
    rivals: tuple[str, ...] = ()
    sentence: str


class ArmPriorResult(Record):
    """The earlier calibration of the same arm that was taken as prior.

    ``run`` and ``stage`` name it, ``since`` is the day of its run, ``sha256`` the hash of its model and readings,
    ``readings`` their number. ``effects`` were carried over; ``left_behind`` belong to the earlier installation.
    ``scatter_mm`` is that of a coordinate of the new readings beyond the stated uncertainty, ``scatter_mrad`` of a
    component of their orientation, None where none was measured.
    """

    run: str
    arm: str
    stage: ModelStage
    since: str
    sha256: str
    readings: int
    controller: str | None = None
    parts: Mapping[SignaturePart, PartDrift]
    effects: tuple[str, ...]
    left_behind: tuple[str, ...] = ()
    scatter_mm: float
    scatter_mrad: float | None = None
    tested: int
    changes: tuple[SignatureChange, ...] = ()


class ClockSegmentResult(Record):
    """Offset of the clocks between two steps of either: from ``first_s`` to ``last_s``, stamps of the tracker."""

    offset_s: float
    offset_standard_error_s: float
    first_s: float
    last_s: float


class ClockResult(Record):
    """The tracker's clock against the controller's in one recording.

    ``offset_s`` is the tracker's stamp less the controller's of the same instant, at the tracker's stamp ``at_s``;
    ``rate_ppm`` is by how much the tracker's clock is faster. Steps are pairs of a stamp and
    the size [s]; where there are some, ``offset_s`` is that of the first of the ``segments`` between them.
    """

    offset_s: float
    offset_standard_error_s: float
    rate_ppm: float
    rate_standard_error_ppm: float
    at_s: float
    steps_of_joints: tuple[tuple[float, float], ...] = ()
    steps_of_points: tuple[tuple[float, float], ...] = ()
    segments: tuple[ClockSegmentResult, ...] = ()
    correlation: float


class RecordingResult(Record):
    """One recording in the fit: points in all, learnt from, of held-out blocks, left out as gross errors, at times at
    which the joints are not known; how many independent points those that were learnt from are worth; ``scatter_mm`` is
    the standard deviation of a coordinate of the residuals."""

    points: int
    learnt: int
    held_out: int
    gross: int
    in_gaps: int
    effective_points: float
    scatter_mm: float
    heldout_rms_mm: float | None


class MotionResult(Record):
    """What recordings of motion told of an arm.

    ``half_play`` is how far each joint lies behind its motor against its last motion, ``validate_`` the errors at the
    points of held-out blocks of time, ``undetermined`` says what these data cannot determine.
    """

    recordings: Mapping[str, RecordingResult]
    effective_points: float
    half_play: Mapping[str, Estimate]
    stops_scatter_mm: float | None = None
    validate_: Mapping[Stage, StageErrors]
    undetermined: tuple[str, ...] = ()


class ParameterEstimate(Estimate):
    """An identified parameter of a geometry, and the ``nominal`` value that it had before.

    ``prior_sigma`` is the standard deviation of its prior about that value, None where only the readings determine it;
    ``correlations`` are its largest ones with others, by name. Earlier versions stored neither of the three. One
    ``at_bound`` is held there and has no standard error; the difference of one that is ``tied_to`` another is the same.
    """

    nominal: float | None = None
    prior_sigma: float | None = None
    correlations: Mapping[str, float] = {}
    at_bound: Literal[True] | None = None
    tied_to: str | None = None
    omitted_when_none = frozenset({"nominal", "prior_sigma", "at_bound", "tied_to"})


def largest_correlations(names: Sequence[str], covariance: Array) -> dict[str, dict[str, float]]:
    """Return the two largest correlations of each parameter with others; ``covariance`` (k, k) has its names' order."""
    sd = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    rho = covariance / np.outer(sd, sd) - np.eye(len(sd))
    largest = np.argsort(-np.abs(rho), axis=1)[:, :2].tolist()
    return {
        name: {names[other]: float(rho[row, other]) for other in largest[row] if other != row}
        for row, name in enumerate(names)
    }


def tied_estimates(
    found: Mapping[str, ParameterEstimate], tied_to: Mapping[str, str], nominal: Mapping[str, float]
) -> dict[str, ParameterEstimate]:
    """Return the estimates of parameters that are tied to those found: other values, with the same difference."""
    beside = {}
    for name, first in tied_to.items():
        if first in found:
            value = nominal[name] + found[first].value - nominal[first]
            its = {"value": value, "nominal": nominal[name], "tied_to": first}
            beside[name] = found[first].model_copy(update=its)
    return beside


class ArmCalibrationResult(Record):
    """Calibration of one arm.

    ``identified`` are the parameters of the geometry, ``rank`` the number of independent ones, ``merged`` maps each
    dropped parameter to those that take its place and their shares, ``fixed`` each held parameter to its value.
    ``excess_mm`` is the scatter of a coordinate beyond the stated uncertainty, ``excess_mrad`` that of an orientation,
    ``tracker_mm`` and ``probe_mrad`` the rms length of the stated noise of positions and of orientations. A fit that
    has not ``converged`` is no result. Where an earlier calibration was taken as ``prior``, the stage ``effects`` is
    the model with it, and the others are those without. ``left_out_configurations`` are those of readings with gross
    errors, on which nothing here rests; ``splits`` counts the others.
    An arm that was recorded in ``motion`` has the ``clocks`` of its recordings; where it has no held-out readings at
    rest, ``validate_`` and ``splits`` are those of the points in motion.
    """

    identified: Mapping[str, ParameterEstimate]
    rank: int
    parameter_set: str
    merged: Mapping[str, Mapping[str, float]]
    fixed: Mapping[str, float] | None = None
    iterations: int
    converged: Literal[True] = True
    condition: float | None
    scatter: Scatter
    excess_mm: float | None = None
    excess_mrad: float | None = None
    degrees_of_freedom: int
    splits: Mapping[str, int]
    tracker_mm: float | None = None
    probe_mrad: float | None = None
    repeatability_mm: Repeatability | None = None
    network: NetworkResult | None = None
    prior: ArmPriorResult | None = None
    left_out_configurations: tuple[int, ...] = ()
    validate_: Mapping[Stage, StageErrors]
    clocks: Mapping[str, ClockResult] | None = None
    motion: MotionResult | None = None
    omitted_when_none = frozenset({"fixed", "excess_mrad", "probe_mrad", "prior", "clocks", "motion"})

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
    """Cooperative errors of one method on held-out stops, with the transform that the profile chose and with both.

    ``..._mrad`` are the angles between the measured and the computed rotation of one flange in the other's frame, where
    both have a probe; the transform by ``distances`` is then of distances and these rotations together.
    """

    cooperative_mm: ErrorSummary
    cooperative_mrad: ErrorSummary | None = None
    transform: str | None = None
    by_transform_mm: Mapping[str, ErrorSummary] = {}
    by_transform_mrad: Mapping[str, ErrorSummary] | None = None
    identified: Mapping[str, PairEstimate] = {}
    iterations: int | None = None
    converged: Literal[True] = True
    splits: Mapping[str, int] = {}
    held_out: PairHeldOut | None = None
    omitted_when_none = frozenset({"cooperative_mrad", "by_transform_mrad"})


class CalibrateResult(Result, schema="cellapp-calibrate"):
    """``calibrate``: every arm, the pair by method, notes."""

    arms: Mapping[str, ArmCalibrationResult]
    pair: Mapping[Method, PairMethodResult]
    notes: tuple[str, ...]
    provenance: Provenance

    def without_effects(self) -> CalibrateResult:
        """This result without the stage ``effects``, which older versions wrote into it; with it where it is that of an
        earlier calibration that was taken as prior."""
        if any(arm.prior is not None for arm in self.arms.values()):
            return self
        arms = {
            name: arm.model_copy(update={"validate_": {k: v for k, v in arm.validate_.items() if k != "effects"}})
            for name, arm in self.arms.items()
        }
        pair = {method: entry for method, entry in self.pair.items() if method != "effects"}
        return self.model_copy(update={"arms": arms, "pair": pair})
