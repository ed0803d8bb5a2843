"""All data of one page, read from a run once.

First words of the page: warnings, and results that are out of date.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from cellapp.cell.run.measurement_order import read_in_order
from cellapp.cell.run.recordings import known_readings
from cellapp.cell.run.records import ArmOrder
from cellapp.cell.run.sqlite_file import Event
from cellapp.commands.calibrate.held_out import HeldOutArm
from cellapp.commands.compensate.words import Measured
from cellapp.commands.next_step import Next
from cellapp.commands.run_results import RunResults
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import HERE, next_command
from cellapp.commands.stored_model import model_of
from cellapp.estimation.calibration.quantities import conditions_of_arms
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.readings import Readings
from cellapp.estimation.uncertainty.records import Judgement
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import CALIBRATE, CHECK, DISCOVER
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
    next_step : Next or None
        The first step that is missing or out of date; None if there is none.
    judgements : tuple
        Every error against its tolerance.
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
    next_step: Next | None
    judgements: tuple[Judgement, ...] = ()

    @property
    def discover(self) -> DiscoverResult | None:
        """The discovery; None if it no longer holds."""
        return self.results.held.discover

    @property
    def model(self) -> CellModel:
        """The newest model that holds."""
        return self.discovered or self.calibrated

    @cached_property
    def held_out(self) -> Mapping[str, HeldOutArm]:
        """The held-out readings of each arm, without gross errors, with the predictions of every stage."""
        discovered = {} if self.discovered is None else self.discovered.arms
        conditions = conditions_of_arms(self.model.arms, self.readings)
        return {
            name: HeldOutArm.of(
                self.readings[name], conditions[name], self.calibrate.arms[name], arm, discovered.get(name)
            )
            for name, arm in self.calibrated.arms.items()
        }


def read_report_data(state: RunState) -> ReportData:
    """Read results, models and readings of a run.

    Raises
    ------
    InputError
        If the run is not calibrated, or its calibration cannot be read.
    """
    run, stages, results = state.run, state.stages, state.results
    again = next_command("calibrate", run.folder)
    if results.calibrate is None:
        reason = results.out_of_date.get(CALIBRATE, "not calibrated yet")
        raise InputError(f"{run.path}: {reason}, nothing to report; run '{again}' first")
    if stages.in_force is None or stages.in_force.model is None:
        raise InputError(f"{run.path}: the calibrated model is missing; run '{again}' first")
    calibrated, measured = model_of(run, stages.current[CALIBRATE]), run.arms()
    missing = state.missing_step(HERE)
    return ReportData(
        profile=run.profile,
        results=results,
        calibrate=results.calibrate,
        calibrated=calibrated,
        discovered=None if results.held.discover is None else model_of(run, stages.current[DISCOVER]),
        readings={
            name: run.readings(name) if name in measured else known_readings(run, name) for name in calibrated.arms
        },
        in_order=read_in_order(run),
        events=tuple(run.events()),
        model_in_force=stages.in_force.model,
        next_step=None if missing is None or missing.verb == "report" else missing,
        judgements=state.judgements,
    )


def warnings(data: ReportData) -> list[str]:
    """Return the calibration's notes, and why targets were not measured."""
    targets: list[Measured] = [*data.results.verified.targets, *data.results.verified.pairs]
    return [*data.calibrate.notes] + [f"target {target.name}: {target.note}" for target in targets if target.note]


def out_of_date_lines(data: ReportData) -> list[tuple[str, str]]:
    """Return the name and reason of each result that no longer holds, and what a check found."""
    lines: list[tuple[str, str]] = list(data.results.out_of_date.items())
    checked = data.results.held.check
    if checked is not None and checked.found_change:
        lines += [(CHECK, complaint) for complaint in checked.complaints()]
    return lines
