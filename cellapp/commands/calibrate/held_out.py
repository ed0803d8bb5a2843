"""Held-out readings of one arm, and the predictions of each stage's model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellapp.estimation.calibration.quantities import position_errors
from cellapp.estimation.calibration.records import ArmCalibrationResult
from cellapp.estimation.readings import Readings
from cellapp.ground.results import STAGES
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel


@dataclass(frozen=True)
class HeldOutArm:
    """Held-out readings of one arm, and the models that predict them."""

    readings: Readings
    conditions: MeasurementConditions
    calibrated: ArmModel
    discovered: ArmModel | None

    @classmethod
    def of(
        cls,
        readings: Readings,
        conditions: MeasurementConditions,
        result: ArmCalibrationResult,
        calibrated: ArmModel,
        discovered: ArmModel | None,
    ) -> HeldOutArm:
        """Select the held-out readings of an arm without gross errors, and their conditions."""
        rows = readings.in_split("validate")
        rows = rows[~np.isin(readings.configuration[rows], result.left_out_configurations)]
        return cls(readings.take(rows), conditions.take(rows), calibrated, discovered)

    @cached_property
    def computed_M(self) -> Mapping[str, Array]:
        """Computed SMR positions (n, 3) [m] by stage.

        A calibration with a prior, or from an older version, has its effects in its only model: it has no stage
        ``geometry``.
        """
        model, q = self.calibrated, self.readings.q
        computed: dict[str, Array] = {"nominal": smr_positions(model.nominal, q)}
        if not model.effects:
            computed["geometry"] = smr_positions(model.geometry, q)
            if model.network is not None:
                computed["network"] = self._predict(model)
        newest = model if self.discovered is None else self.discovered
        if newest.effects:
            computed["effects"] = self._predict(newest)
        return {stage: computed[stage] for stage in STAGES if stage in computed}

    @cached_property
    def errors_mm(self) -> Mapping[str, Array]:
        """Position errors (n,) [mm] by stage; the stages are those of ``computed_M``."""
        return {
            stage: position_errors(self.readings.p_M, computed) * 1e3 for stage, computed in self.computed_M.items()
        }

    def _predict(self, model: ArmModel) -> Array:
        return model.predict(self.readings.q, conditions=self.conditions)
