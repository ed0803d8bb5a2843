"""Results of calibration and discovery: a model of the cell with predictions, tables, charts and compensation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from cellapp.cell.targets.records import CompensateResult, TargetCommand
from cellapp.cell.targets.targets import Target, load_targets, targets_in_memory
from cellapp.commands.calibrate.charts_accuracy import (
    error_histogram_chart,
    pair_histogram_chart,
    stage_chart,
    stop_error_chart,
)
from cellapp.commands.calibrate.held_out import HeldOutArm
from cellapp.commands.calibrate.view import parameters_view
from cellapp.commands.calibrate.view import view as calibration_view
from cellapp.commands.compensate.run import compensate_targets
from cellapp.commands.compensate.view import view as compensation_view
from cellapp.commands.compensate.words import compensate_summary
from cellapp.commands.discover.charts import candidates_chart, gap_chart, picture_chart
from cellapp.commands.discover.run import discover_effects
from cellapp.commands.discover.view import view as discovery_view
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Parts
from cellapp.estimation.calibration.quantities import conditions_of_arms
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, ignore
from cellapp.interfaces.python.conditions import stated_conditions
from cellapp.interfaces.python.printed import Charted, Printed
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, apply
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.arguments import configurations, of_arm, require_radians

if TYPE_CHECKING:
    import pandas as pd


def measured_minus_computed(model: CellModel, readings: Mapping[str, Readings]) -> dict[str, Array]:
    """Compute residuals (n, 3) [m] in frame M of all readings of each arm, in their order and at their conditions."""
    conditions = conditions_of_arms(model.arms, readings)
    return {
        name: np.asarray(
            (arm.p_M if model.T_M_M0 is None else apply(model.T_M_M0, arm.p_M))
            - model.arms[name].predict(arm.q, conditions=conditions[name])
        )
        for name, arm in readings.items()
    }


@dataclass(frozen=True, eq=False, repr=False)
class Fitted(Charted):
    """A model of the cell with the readings that it was fitted to.

    Attributes
    ----------
    profile : Profile
    readings : mapping
        Arm -> Readings, with the split of each.
    model : CellModel
        Has further methods; it also saves itself: ``model.save(Path("calibration.json"))``.
    """

    profile: Profile
    readings: Mapping[str, Readings]
    model: CellModel

    def predict(self, arm: str, q: ArrayLike, **conditions: ArrayLike) -> Array:
        """Predict SMR positions (n, 3) in the tracker frame [m] at controller readings ``q`` (n, N) [rad] of an arm.

        Parameters
        ----------
        conditions
            Inputs of effects, unknown if not given: ``approach``, ``step`` [rad], ``joint_temperature_c`` (n, N);
            ``payload_kg``, ``dwell_s``, ``time_s``, ``temperature_c`` (n,); ``other_q`` (n, K) [rad], the joints of the
            other arm. One number, or one row, stands for all.

        Raises
        ------
        InputError
            If there is no such arm or condition, or something has another shape or seems to be in degrees.
        """
        model, at, stated = self._asked(arm, q, conditions)
        return model.predict(at, conditions=stated)

    def uncertainty(self, arm: str, q: ArrayLike, **conditions: ArrayLike) -> Array:
        """Return the standard deviation (n,) [m] of a coordinate as ``predict`` gives it, without measurement noise."""
        model, at, stated = self._asked(arm, q, conditions)
        return model.uncertainty(at, stated)

    def _asked(
        self, arm: str, q: ArrayLike, given: Mapping[str, ArrayLike]
    ) -> tuple[ArmModel, Array, MeasurementConditions | None]:
        model = of_arm(self.model.arms, arm, "this cell")
        at = configurations(q, model.geometry.joints, arm)
        require_radians(at, arm)
        others = [other for name, other in self.model.arms.items() if name != arm]
        record = self._conditions[arm].record
        return model, at, stated_conditions(at, given, arm, others[0] if len(others) == 1 else None, record)

    @cached_property
    def _conditions(self) -> Mapping[str, MeasurementConditions]:
        return conditions_of_arms(self.model.arms, self.readings)

    @cached_property
    def residuals_M(self) -> Mapping[str, Array]:
        """Arm -> measured minus computed SMR positions (n, 3) in the tracker frame [m] of all its readings."""
        return measured_minus_computed(self.model, self.readings)

    def residuals(self) -> pd.DataFrame:
        """Return ``residuals_M`` as a table with one row per reading [mm]. Needs pandas."""
        from cellapp.interfaces.python.frames import residuals_frame

        return residuals_frame(self.readings, self.residuals_M)

    def parameters(self) -> pd.DataFrame:
        """Return every parameter of every arm, effects included: nominal, identified, standard error. Needs pandas."""
        from cellapp.interfaces.python.frames import parameters_frame

        return parameters_frame(self.model)

    def compensate(self, targets: str | Path | Sequence[Any] | Mapping[str, Any] | pd.DataFrame) -> Compensation:
        """Compute joint positions that bring the real arms to Cartesian targets.

        Parameters
        ----------
        targets
            The path of a list of targets (YAML or CSV); or a list of mappings with the keys that a target has in such a
            file, as ``{"name": "A1", "arm": "left", "position": [0.6, 0.1, 0.4]}`` [m]; or a data frame with the
            columns of a CSV file of targets.

        Raises
        ------
        InputError
            If a target does not fit the cell, or the profile does not give the poses of arms and tracker.
        """
        if isinstance(targets, str | Path):
            wanted = load_targets(Path(targets), self.profile)
        else:
            wanted = targets_in_memory(targets, self.profile)
        return Compensation(wanted, compensate_targets(self.profile, self.readings, self.model, wanted)[1])


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Fitted):
    """A calibrated cell. ``result`` is the same object that ``cellapp calibrate`` stores: ``result.to_json()``."""

    result: CalibrateResult

    def discover(self, listener: Listener = ignore, cancel: CancelToken | None = None) -> Discovery:
        """Search every arm for physical effects that this model lacks.

        Raises
        ------
        Cancelled
            If ``cancel`` requests it.
        """
        result, found = discover_effects(self.profile, self.model, self.readings, listener, cancel)
        return Discovery(self.profile, self.readings, found.model, result, self)

    def summary(self) -> str:
        """Return the held-out error of each arm."""
        errors = {name: arm.validate_[arm.best_stage].position_mm for name, arm in self.result.arms.items()}
        return "held out: " + ", ".join(f"{name} {one.mean:.4f} mm (n = {one.n})" for name, one in errors.items())

    def view(self) -> Parts:
        """Return held-out errors, notes and identified parameters, as ``cellapp show`` prints them."""
        return [*calibration_view(self.result).parts, "", *parameters_view(self.result).parts]

    def charts(self) -> Mapping[str, Callable[[], Sequence[Chart]]]:
        """Return charts of the held-out errors: by stage, by configuration, as a histogram, and of the pair."""
        return {
            "stages": lambda: [stage_chart(name, arm) for name, arm in self.result.arms.items()],
            **_error_charts(self, self),
            "pair": lambda: [pair_histogram_chart(self.result)] if self.result.pair else [],
        }


@dataclass(frozen=True, eq=False, repr=False)
class Discovery(Fitted):
    """A calibrated cell with the effects that were found; ``result`` is the object that ``cellapp discover`` stores.

    ``calibration`` is the calibration that was searched.
    """

    result: DiscoverResult
    calibration: Calibration

    @property
    def effects(self) -> dict[str, tuple[str, ...]]:
        """Arm -> accepted effects, with the names of the handbook's chapter on effects."""
        return {name: tuple(one.effect for one in arm.accepted) for name, arm in self.result.arms.items()}

    def summary(self) -> str:
        """Return the effects and the held-out rms error of each arm, before and after."""
        return "; ".join(
            f"{name}: {', '.join(dict.fromkeys(self.effects[name])) or arm.verdict},"
            f" {arm.heldout_mm.before:.4f} -> {arm.heldout_mm.after:.4f} mm"
            for name, arm in self.result.arms.items()
        )

    def view(self) -> Parts:
        """Return the findings, the values of the effects and their meaning, as ``cellapp show`` prints them."""
        return discovery_view(self.result).parts

    def charts(self) -> Mapping[str, Callable[[], Sequence[Chart]]]:
        """Return charts: error after each step, probabilities, pictures of the effects, held-out errors."""
        arms = self.result.arms
        return {
            "steps": lambda: [gap_chart(name, arm) for name, arm in arms.items()],
            "candidates": lambda: [candidates_chart(name, arm) for name, arm in arms.items()],
            "effects": lambda: [picture_chart(name, one) for name, arm in arms.items() for one in arm.pictures],
            **_error_charts(self, self.calibration),
        }


@dataclass(frozen=True, eq=False, repr=False)
class Compensation(Printed):
    """Commands for targets; ``result`` is the object that ``cellapp compensate`` stores.

    Attributes
    ----------
    targets : tuple of Target
    result : CompensateResult
        ``result.targets`` has a record for each target and arm.
    """

    targets: tuple[Target, ...]
    result: CompensateResult

    def q(self, arm: str) -> Array:
        """Return compensated joint positions (n, N) [rad] of an arm at its n targets, in their order; NaN if refused.

        Raises
        ------
        InputError
            If the arm has no target.
        """
        commands = of_arm(self._by_arm, arm, "these targets")
        joints = max((len(one.q_compensated) for one in commands if one.q_compensated is not None), default=0)
        return np.array([one.q_compensated or (np.nan,) * joints for one in commands], dtype=np.float64)

    @cached_property
    def _by_arm(self) -> dict[str, list[TargetCommand]]:
        arms = dict.fromkeys(one.arm for one in self.result.targets)
        return {arm: [one for one in self.result.targets if one.arm == arm] for arm in arms}

    def frame(self) -> pd.DataFrame:
        """Return one row for each target and arm: target, command, predicted uncertainty, refusal. Needs pandas."""
        from cellapp.interfaces.python.frames import targets_frame

        return targets_frame(self.result.targets)

    def summary(self) -> str:
        """Return how many targets can be commanded."""
        return compensate_summary(self.result)[0]

    def view(self) -> Parts:
        """Return commands, uncertainties and notes, as ``cellapp show`` prints them."""
        return compensation_view(self.result).parts


def _error_charts(newest: Fitted, calibration: Calibration) -> dict[str, Callable[[], Sequence[Chart]]]:
    """Return charts of the errors of each arm's held-out readings with every model up to ``newest``."""
    arms = calibration.result.arms

    def held_out(name: str) -> HeldOutArm:
        discovered = None if newest is calibration else newest.model.arms[name]
        conditions = newest._conditions[name]
        return HeldOutArm.of(newest.readings[name], conditions, arms[name], calibration.model.arms[name], discovered)

    return {
        "errors": lambda: [stop_error_chart(name, held_out(name), arm.tracker_mm) for name, arm in arms.items()],
        "histogram": lambda: [
            error_histogram_chart(name, held_out(name).errors_mm, arm.tracker_mm) for name, arm in arms.items()
        ],
    }
