"""Forecast of a run's plan before it is measured: time, covered joint ranges, accuracy, visible effects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.cell.planning.check import required_plan
from cellapp.cell.planning.coverage import joint_coverage
from cellapp.cell.planning.duration import planned_time, stop_times_of
from cellapp.cell.planning.joint_draws import joint_ranges
from cellapp.cell.planning.planned_stops import last_motions
from cellapp.cell.planning.records import ArmForecast, PlanForecastResult
from cellapp.cell.planning.stored_stops import read_planned_stops
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.estimation.calibration.parameters import EXPECTED_SCATTER_M
from cellapp.estimation.discovery.plan_forecast import (
    ArmDesign,
    PlannedReadings,
    arm_designs,
    planned_accuracy,
    planned_effects,
)
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.ground.threads import one_blas_thread
from cellapp.robot.kinematics.transforms import Array


def forecast_run(run: RunFile, listener: Listener = ignore, cancel: CancelToken | None = None) -> PlanForecastResult:
    """Forecast what the plan of a run will give; nothing is written.

    Raises
    ------
    InputError
        If the run has no plan, or the profile does not describe the cell.
    Cancelled
    """
    cancel = cancel or CancelToken()
    required_plan(run)
    profile, plan = run.profile, read_planned_stops(run)
    reserves = profile.plan.reserves(len(plan))
    visited = plan.take([stop for stop in range(len(plan)) if stop not in reserves])
    if not len(visited):
        raise InputError(f"{run.path}: the plan has reserve stops only")
    first = visited.q
    times = stop_times_of(profile, visited)
    step = last_motions(visited, home_positions(profile))
    designs = arm_designs(profile, first, PlannedReadings(times.measured_s, times.resting_s, step, visited.load))
    cell = cell_bodies(profile)
    arms: dict[str, ArmForecast] = {}
    notes: list[str] = []
    for number, (name, design) in enumerate(designs.items()):
        cancel.check()
        listener(Progress("forecast", number, len(designs), f"arm {name}"))
        try:
            with one_blas_thread():  # the matrices are small
                effects = planned_effects(design)
        except InputError as error:
            effects = ()
            notes.append(str(error))
        arms[name] = ArmForecast(
            stops=len(visited),
            reserves=len(reserves),
            noise_rms_mm=_noise_rms_mm(design),
            coverage=joint_coverage(joint_ranges(cell, profile, name), first[name]),
            accuracy=tuple(planned_accuracy(design, scatter) for scatter in (0.0, EXPECTED_SCATTER_M)),
            effects=effects,
        )
    listener(Progress("forecast", len(designs), len(designs), "done"))
    return PlanForecastResult(
        run=str(run.folder),
        time=planned_time(profile, visited),
        arms=arms,
        notes=(*notes, *_notes(profile, first)),
    )


def _noise_rms_mm(design: ArmDesign) -> float:
    """Compute the rms length of the tracker's noise at the stops [mm]."""
    covariance = design.data.stated
    assert covariance is not None
    return 1e3 * float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))


def _notes(profile: Profile, plan: Mapping[str, Array]) -> list[str]:
    return [
        f"arm {name}: smr.offset is unknown; an offset of some centimetres beside the last axis was assumed"
        for name in plan
        if profile.arms[name].smr.offset == "unknown"
    ]
