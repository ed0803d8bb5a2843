"""Present station of a run's tracker, and the scatter of its readings about the model; used by several verbs."""

from __future__ import annotations

import math

from cellapp.cell.run import RunFile
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import RunStages, read_history, read_stages, tracker_moved
from cellapp.estimation.calibration.least_squares import mean_variance
from cellapp.estimation.monitoring.records import LocateResult
from cellapp.estimation.readings.readings import stated_uncertainty
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Pose, Profile
from cellapp.ground.results import CHECK, ISO9283, LOCATE, VERIFY
from cellapp.ground.shell import shell_word
from cellapp.robot.model import CellModel

_MEASURED_BY = (LOCATE, CHECK, VERIFY, ISO9283)
"""Results that jobs after the calibration leave in the run."""


def profile_at_station(run: RunFile, stages: RunStages, simulated_pose: Pose | None = None) -> Profile:
    """Return the profile of a run for jobs that open the cell; a simulated tracker is where it was moved to, with
    noise that no job had before.

    ``simulated_pose`` moves it. Raises ``InputError`` if one is given and the tracker is not simulated.
    """
    profile = run.profile
    simulated = profile.plant is not None and profile.tracker.driver.needs_plant
    if simulated_pose is not None and not simulated:
        raise InputError(
            "check: --simulated-pose moves the tracker of a simulated cell; the profile's tracker is not simulated"
        )
    last = last_location(run, stages)
    if simulated_pose is None and last is not None and last.simulated_pose is not None:
        simulated_pose = Pose(position=last.simulated_pose.position, rpy=last.simulated_pose.rpy)
    if profile.plant is None:
        return profile
    plant = profile.plant.after(sum(one.name in _MEASURED_BY for one in read_history(run)))
    if simulated_pose is not None:
        plant = plant.model_copy(update={"tracker_pose": simulated_pose})
    return profile.model_copy(update={"plant": plant})


def last_location(run: RunFile, stages: RunStages) -> LocateResult | None:
    """Return the last location of the tracker; None if there is none."""
    stored = stages.current.get(LOCATE)
    return None if stored is None else LocateResult.from_json(stored.text, f"{run.path}: {LOCATE}")


def refuse_second_station(run: RunFile) -> None:
    """Raise ``InputError`` if something was moved since the run's readings: new ones would not fit them."""
    located = read_stages(run).current.get(LOCATE)
    if located is None or (located.model is not None and not tracker_moved(located)):
        return
    what = "the tracker" if located.model is not None else "the tracker or an arm"
    raise InputError(
        f"{run.path}: {what} was moved since the readings of this run were taken: 'cellapp show"
        f" {shell_word(run.folder)} location'."
        " Readings from two stations do not calibrate together: plan and collect a new run, or put it back and locate"
        " the tracker again"
    )


def excess_of_readings(state: RunState, model: CellModel) -> dict[str, float]:
    """Return the scatter [m] of a coordinate about the model beyond the tracker's covariance, by arm.

    It is the model's own value; without one it follows from the errors at held-out stops.
    """
    stored, found = state.results.calibrate, {}
    for name, arm in model.arms.items():
        noise_m = 0.0 if arm.posterior is None else arm.posterior.noise.m
        if arm.posterior is None and stored is not None:
            result = stored.arms[name]
            noise_m = result.validate_[result.best_stage].position_mm.rms * 1e-3 / math.sqrt(3.0)
        stated = stated_uncertainty(state.run.readings(name))
        tracker = 0.0 if stated is None else mean_variance(stated)
        found[name] = math.sqrt(max(noise_m**2 - tracker, 0.0))
    return found
