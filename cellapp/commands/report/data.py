"""All data of one page, read from a run once.

First words of the page: warnings, and results that are out of date.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from cellapp.cell.run import RunFile
from cellapp.cell.run.measurement_order import read_in_order
from cellapp.cell.run.recordings import known_readings
from cellapp.cell.run.records import ArmOrder
from cellapp.cell.run.sqlite_file import Event
from cellapp.commands.calibrate.held_out import HeldOutArm
from cellapp.commands.certificate.judgements import judge_run
from cellapp.commands.next_step import Step, arm_states, missing_step
from cellapp.commands.run_results import RunResults, read_results
from cellapp.commands.stages import HERE, RunStages, next_command, read_stages
from cellapp.estimation.calibration.quantities import conditions_of_arms
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.readings import Readings
from cellapp.estimation.uncertainty.budget import measured_conditions
from cellapp.estimation.uncertainty.records import Judgement
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import CALIBRATE, CHECK, DISCOVER, StageName
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel


@dataclass(frozen=True)
class ReportData:
    """Profile, current results, the models of calibration and discovery, and the readings of a calibrated run.

    Attributes
    ----------
    calibrated : CellModel
        The model that ``calibrate`` stored: geometry, and a residual network if one is used.
    discovered : CellModel or None
        The model that ``discover`` stored; None if the discovery no longer holds.
    in_order : mapping
        What an import derived from the order of the readings, by arm.
    model_in_force : str
        The stored model (JSON) that compensation uses; the same text as in ``calibration.json``.
    next_step : Step or None
        The first step that is missing or out of date; None if there is none.
    """

    profile: Profile
    results: RunResults
    calibrate: CalibrateResult
    calibrated: CellModel
    discovered: CellModel | None
    readings: Mapping[str, Readings]
    in_order: Mapping[str, ArmOrder]
    events: tuple[Event, ...]
    model_in_force: str
    next_step: Step | None

    @property
    def discover(self) -> DiscoverResult | None:
        """The discovery; None if it no longer holds."""
        return self.results.held.discover

    @property
    def model(self) -> CellModel:
        """The newest model that holds."""
        return self.discovered or self.calibrated

    @cached_property
    def judgements(self) -> tuple[Judgement, ...]:
        """Every error against its tolerance."""
        return judge_run(self.profile, self.results, measured_conditions(self.readings))

    @cached_property
    def conditions(self) -> Mapping[str, MeasurementConditions]:
        """The conditions of the readings of each arm."""
        return conditions_of_arms(self.model.arms, self.readings)

    @cached_property
    def residuals_M(self) -> Mapping[str, Array]:
        """Measured minus computed positions (n, 3) [m] of all readings of each arm, with the newest model."""
        return {
            name: readings.p_M - self.model.arms[name].predict(readings.q, conditions=self.conditions[name])
            for name, readings in self.readings.items()
        }

    @cached_property
    def held_out(self) -> Mapping[str, HeldOutArm]:
        """The held-out readings of each arm, without gross errors, with the predictions of every stage."""
        return {name: self._held_out_arm(name, self.conditions[name]) for name in self.calibrated.arms}

    def _held_out_arm(self, name: str, conditions: MeasurementConditions) -> HeldOutArm:
        return HeldOutArm.of(
            self.readings[name],
            conditions,
            self.calibrate.arms[name],
            self.calibrated.arms[name],
            None if self.discovered is None else self.discovered.arms[name],
        )


def read_report_data(run: RunFile) -> ReportData:
    """Read results, models and readings of a run.

    Raises
    ------
    InputError
        If the run is not calibrated, or its calibration cannot be read.
    """
    stages = read_stages(run)
    results = read_results(run, stages)
    again = next_command("calibrate", run.folder)
    if results.calibrate is None:
        reason = results.out_of_date.get(CALIBRATE, "not calibrated yet")
        raise InputError(f"{run.path}: {reason}, nothing to report; run '{again}' first")
    calibrated = _stored_model(run, stages, CALIBRATE)
    if calibrated is None or stages.in_force is None or stages.in_force.model is None:
        raise InputError(f"{run.path}: the calibrated model is missing; run '{again}' first")
    discovered = None if results.held.discover is None else _stored_model(run, stages, DISCOVER)
    measured, missing = run.arms(), missing_step(run, stages, arm_states(run), HERE)
    return ReportData(
        profile=run.profile,
        results=results,
        calibrate=results.calibrate,
        calibrated=calibrated,
        discovered=discovered,
        readings={
            name: run.readings(name) if name in measured else known_readings(run, name) for name in calibrated.arms
        },
        in_order=read_in_order(run),
        events=tuple(run.events()),
        model_in_force=stages.in_force.model,
        next_step=None if missing is None or missing.verb == "report" else missing,
    )


def _stored_model(run: RunFile, stages: RunStages, name: StageName) -> CellModel | None:
    text = stages.current[name].model
    return None if text is None else CellModel.from_json(text, f"{run.path}: model of '{name}'")


STAGE_TITLES: dict[StageName, str] = {
    "calibrate": "Calibration",
    "discover": "Missing effects",
    "locate": "Station of the tracker",
    "compensate": "Compensated targets",
    "push": "Pushed targets",
    "verify": "Verification at new targets",
    "path": "Compensated paths",
    "iso9283": "Tests by ISO 9283",
    "check": "Check of the calibration",
    "certificate": "Certificate",
}


def warnings(data: ReportData) -> list[str]:
    """Return the calibration's notes, and why targets were not measured."""
    targets = data.results.verified.targets
    return [*data.calibrate.notes] + [f"target {target.name}: {target.note}" for target in targets if target.note]


def out_of_date_lines(data: ReportData) -> list[tuple[str, str]]:
    """Return the title and reason of each result that no longer holds, and what a check found."""
    lines = [(STAGE_TITLES[name], reason) for name, reason in data.results.out_of_date.items()]
    checked = data.results.held.check
    if checked is not None and checked.found_change:
        lines += [(STAGE_TITLES[CHECK], complaint) for complaint in checked.complaints()]
    return lines
