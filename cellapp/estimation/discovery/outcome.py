"""Outcome of discovery: the stored result, and the model with the accepted effects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cellapp.estimation.calibration.calibrate import rms_length_mm
from cellapp.estimation.calibration.pair_calibration import PairCalibration
from cellapp.estimation.calibration.quantities import ArmReadings, Quantities, evaluate_quantities, position_errors
from cellapp.estimation.discovery.records import (
    ArmDiscoveryResult,
    BeforeAfter,
    HeldOutBeforeAfter,
    HeldOutPosition,
    PredictedUncertainty,
)
from cellapp.estimation.readings import stated_uncertainty
from cellapp.ground.results import StageErrors
from cellapp.robot.effects import EffectTerm
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel

# -- Held-out readings (the validate split), on which the error of a model is evaluated -------------------------------

_SAMPLING_ERRORS = 2.5
"""Standard errors of the mean difference of squares beyond which a model predicts worse: a probability of 0.6 %."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Held-out readings of one arm."""

    measured: Quantities

    @classmethod
    def of(cls, arm: ArmReadings) -> HeldOut:
        """Take the validate split."""
        return cls(arm.take(arm.readings.in_split("validate")).quantities())

    @cached_property
    def points(self) -> Quantities:
        """The positions among them: one of each reading."""
        return self.measured.positions

    def __len__(self) -> int:
        return len(self.points)

    def rms_mm(self, model: ArmModel) -> float:
        """Return the rms position error of a model [mm]."""
        return self.position_mm(model).rms

    def position_mm(self, model: ArmModel) -> HeldOutPosition:
        """Return statistics of the position error of a model [mm]."""
        return _statistics(self.errors_m(model) * 1e3)

    def predicts_worse(self, model: ArmModel, other: ArmModel) -> bool:
        """Return whether a model predicts worse than another one by more than sampling explains, reading by reading."""
        more = self.errors_m(model) ** 2 - self.errors_m(other) ** 2
        return bool(more.mean() > _SAMPLING_ERRORS * more.std() / math.sqrt(len(more)))

    def errors_m(self, model: ArmModel) -> Array:
        """Return the position errors (n,) of a model [m]."""
        return position_errors(self.points.readings.p_M, self.points.predicted(model))

    def orientation_mrad(self, model: ArmModel) -> HeldOutPosition | None:
        """Return statistics of the orientation error of a model [mrad]; None if no orientation was measured."""
        if (angular := self.measured.angular) is None:
            return None
        return _statistics(np.linalg.norm(self.measured.take(angular).predicted(model), axis=1) * 1e3)

    def rotations_before_after(self, before: ArmModel, after: ArmModel) -> HeldOutBeforeAfter | None:
        """Return ``orientation_mrad`` of two models; None if no orientation was measured."""
        errors = [self.orientation_mrad(model) for model in (before, after)]
        if errors[0] is None or errors[1] is None:
            return None
        return HeldOutBeforeAfter(before=errors[0], after=errors[1])

    def evaluate(self, model: ArmModel) -> StageErrors:
        """Return the position, orientation and distance errors of a model."""
        return evaluate_quantities(self.measured, self.measured.predicted(model))

    def noise_floor_mm(self) -> float:
        """Return the rms length of the stated noise [mm]; NaN if the readings state none."""
        sigma = stated_uncertainty(self.points.readings)
        return math.nan if sigma is None else rms_length_mm(sigma)

    def predicted_uncertainty_mm(self, model: ArmModel) -> PredictedUncertainty | None:
        """Return the median and largest uncertainty that a model predicts here [mm]; None if it predicts none."""
        predicted = model.uncertainty(self.points.readings.q, self.points.conditions)
        if not predicted.any():
            return None
        return PredictedUncertainty(median=float(np.median(predicted)) * 1e3, largest=float(predicted.max()) * 1e3)


def _statistics(errors: Array) -> HeldOutPosition:
    """Return mean, rms, median and maximum of errors (n,)."""
    return HeldOutPosition(
        mean=float(errors.mean()),
        rms=float(np.sqrt(np.mean(errors**2))),
        median=float(np.median(errors)),
        max=float(errors.max()),
    )


@dataclass(frozen=True)
class ArmFound:
    """Outcome of discovery in one arm's data.

    Attributes
    ----------
    result : ArmDiscoveryResult
        Accepted effects with their evidence, errors, tests of the residuals, and the verdict.
    terms : tuple of EffectTerm
        Terms of the accepted effects, in the same order, and among them the parts of the unnamed term.
    model : ArmModel
        The arm with these terms.
    scatter_m : float
        Standard deviation of a coordinate beyond the stated uncertainty in the final model [m].
    """

    result: ArmDiscoveryResult
    terms: tuple[EffectTerm, ...]
    model: ArmModel
    scatter_m: float = 0.0

    def with_model(self, model: ArmModel, held_out: HeldOut, **changes: Any) -> ArmFound:
        """Return the outcome with another final model, its errors on held-out readings, and changes of the result."""
        result = self.result
        before, after = result.heldout_position_mm, held_out.position_mm(model)
        angles, angles_after = result.heldout_orientation_mrad, held_out.orientation_mrad(model)
        errors: dict[str, Any] = {
            "heldout_mm": BeforeAfter(before=result.heldout_mm.before, after=after.rms),
            "heldout_position_mm": None if before is None else HeldOutBeforeAfter(before=before.before, after=after),
            "validate_": {"effects": held_out.evaluate(model)} if self.terms else {},
        }
        if angles is not None and angles_after is not None:
            errors["heldout_orientation_mrad"] = HeldOutBeforeAfter(before=angles.before, after=angles_after)
        return ArmFound(result.model_copy(update={**errors, **changes}), self.terms, model, self.scatter_m)


@dataclass(frozen=True)
class CellDiscovery:
    """Outcome of discovery in the data of every arm.

    ``model`` is the cell with the accepted effects; ``pair`` the cooperative errors with them, None if no effect was
    accepted or there is no pair.
    """

    arms: Mapping[str, ArmFound]
    model: CellModel
    pair: PairCalibration | None
