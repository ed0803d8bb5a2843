"""Outcome of discovery in one arm's data: accepted effects with their evidence, verdict, and the extended model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from cellapp.estimation.calibration.pair_calibration import PairCalibration
from cellapp.estimation.discovery.describe import Description
from cellapp.estimation.discovery.records import (
    AbsentEffect,
    BeforeAfter,
    CycleBand,
    HeldOutPosition,
    Noise,
    Picture,
    PlaceMovement,
    PredictedUncertainty,
    RemainingStructure,
)
from cellapp.estimation.discovery.search.state import Rival
from cellapp.ground.results import StageErrors, Verdict
from cellapp.robot.effects import EffectTerm
from cellapp.robot.model import ArmModel, CellModel


@dataclass(frozen=True)
class AcceptedEffect:
    """An effect that became part of the model, with its evidence.

    Attributes
    ----------
    term : EffectTerm
    joints : tuple of int
        Joints it offsets, from 1.
    acts_on : tuple of str
        Joints or frames it acts on.
    score, p_value : float
        Score beside all other effects, and its p-value corrected for the whole scan.
    heldout_before_mm, heldout_after_mm : float
        Held-out rms error without and with it.
    rivals : tuple of Rival
    correlated : (str, float), optional
        Geometric parameter that its values are most correlated with, and the correlation.
    cycles : mapping, optional
        Dominant cycles per revolution of each joint, of a transmission error.
    description : Description, optional
        Of a data-driven term.
    posterior : float
        Probability that the effect is there, from the evidences of competing sets; NaN where it was not computed.
    movements : tuple of PlaceMovement
        How far it moves the SMR by each joint or frame, the largest first.
    """

    term: EffectTerm
    joints: tuple[int, ...]
    acts_on: tuple[str, ...]
    score: float
    p_value: float
    heldout_before_mm: float
    heldout_after_mm: float
    rivals: tuple[Rival, ...]
    correlated: tuple[str, float] | None
    cycles: Mapping[str, CycleBand] | None = None
    description: Description | None = None
    posterior: float = math.nan
    movements: tuple[PlaceMovement, ...] = ()

    @property
    def law_misfit(self) -> float | None:
        """Rms displacement of the SMR by its smooth free part over that by its law; None where it has no free part."""
        return self.term.law_misfit if self.term.modulations else None

    @property
    def answer_set(self) -> tuple[str, ...]:
        """The effect and all that these data cannot distinguish from it."""
        return (self.term.slug, *(rival.slug for rival in self.rivals if not rival.distinguishable))


@dataclass(frozen=True)
class GapStep:
    """The held-out rms error after one step of the search."""

    what: str
    effect: str
    heldout_mm: float


@dataclass(frozen=True)
class Discovery:
    """Outcome of discovery in one arm's data.

    Attributes
    ----------
    accepted : tuple of AcceptedEffect
    noise_floor_mm : float
        Rms length of the stated noise; NaN where none is stated.
    before, after : HeldOutPosition
        Held-out position error with the geometry alone and with the accepted effects.
    seconds : float
        Wall time of the search [s].
    steps : tuple of GapStep
    threshold : float
        Score that an effect had to pass.
    omnibus_p, scatter : float
        p-value and root of chi-square per degree of freedom of what is left; NaN where no noise is stated.
    invisible, not_found : tuple of AbsentEffect
        Effects that this plan cannot show, and those that it could have shown, with the smallest size.
    verdict, sentence : str
    model : ArmModel
        With the accepted effects.
    stage : StageErrors
        Held-out errors of that model.
    pictures : tuple of Picture
    scatter_m : float
        Standard deviation of a coordinate beyond the stated uncertainty in the final model [m].
    network_mm : BeforeAfter, optional
        Rms correction of a residual network before and after.
    uncertainty_mm : PredictedUncertainty, optional
        Predicted uncertainty at the held-out stops.
    noise_mm : Noise, optional
        Noise of the readings, stated or estimated.
    candidates : mapping
        Posterior probability of every effect that was tested, by its slug.
    structure : RemainingStructure, optional
        Tests for structure in what is left.
    left_out : tuple of int
        Configurations of readings with gross errors, on which nothing here rests.
    """

    accepted: tuple[AcceptedEffect, ...]
    noise_floor_mm: float
    before: HeldOutPosition
    after: HeldOutPosition
    seconds: float
    steps: tuple[GapStep, ...]
    threshold: float
    omnibus_p: float
    scatter: float
    invisible: tuple[AbsentEffect, ...]
    not_found: tuple[AbsentEffect, ...]
    verdict: Verdict
    sentence: str
    model: ArmModel
    stage: StageErrors
    pictures: tuple[Picture, ...] = ()
    scatter_m: float = 0.0
    network_mm: BeforeAfter | None = None
    uncertainty_mm: PredictedUncertainty | None = None
    noise_mm: Noise | None = None
    candidates: Mapping[str, float] = field(default_factory=dict)
    structure: RemainingStructure | None = None
    left_out: tuple[int, ...] = ()


@dataclass(frozen=True)
class CellDiscovery:
    """Outcome of discovery in the data of every arm.

    ``model`` is the cell with the accepted effects; ``pair`` the cooperative errors with them, None where no effect was
    accepted or there is no pair.
    """

    arms: Mapping[str, Discovery]
    model: CellModel
    pair: PairCalibration | None
