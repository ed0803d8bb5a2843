"""The verb ``check``: measure a few stops to see whether a run's calibration still holds, and what changed."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellapp.cell.driving.cell_checks import noting_controllers
from cellapp.cell.driving.check import DrivenCheck, MeasuredStop, check_candidates, drive_check
from cellapp.cell.driving.measuring import FoundPoint, points_of
from cellapp.cell.driving.requests import running_job
from cellapp.cell.driving.supervision import moving_cell
from cellapp.cell.driving.verification import measured_rotation
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import known_readings
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.commands.check.locate import locate_run, typed_pose
from cellapp.commands.check.request import CheckRequest
from cellapp.commands.confirm import confirmation
from cellapp.commands.record import Work
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import RunStages, StoredStage, append_stage, basis_on_model
from cellapp.commands.station import excess_of_readings, profile_at_station
from cellapp.commands.stored_model import arms_stage, model_of, stage_in_force
from cellapp.estimation.calibration.station_location import predicted_points
from cellapp.estimation.monitoring.belief import CheckBelief, check_belief
from cellapp.estimation.monitoring.causes import Design
from cellapp.estimation.monitoring.records import (
    CHANGES_OF_ARMS,
    CheckedPoint,
    CheckedStop,
    CheckResult,
    CheckVerdict,
    LocateResult,
)
from cellapp.estimation.monitoring.sequential import SequentialTest, choose_stops, design_of
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import Plant
from cellapp.ground.results import CHECK, LOCATE
from cellapp.ground.shell import shell_word
from cellapp.robot.kinematics.transforms import xyz_of
from cellapp.robot.model import ArmModel, CellModel


def run(request: CheckRequest, work: Work) -> CheckResult | LocateResult:
    """Measure whether the calibration still holds, or where the moved tracker stands now."""
    with RunFile.open(request.folder, write=True) as opened:
        if request.tracker_moved:
            tracker, simulated = (
                None if text is None else typed_pose(text, request.option_of(name))
                for name, text in (("tracker_pose", request.tracker_pose), ("simulated_pose", request.simulated_pose))
            )
            return locate_run(opened, request, work, tracker_pose=tracker, simulated_pose=simulated)
        plant = None if request.simulated_plant is None else plant_of(request.simulated_plant)
        return check_run(opened, request, work, plant)


def check_run(run: RunFile, request: CheckRequest, work: Work, plant: Plant | None = None) -> CheckResult:
    """Measure stops of all arms, judge the model in force by them, and store the result.

    The test ends early once it decides. ``plant`` replaces the simulated cell's hidden physics for this job,
    to show a change.

    Raises
    ------
    InputError
        If the run is not calibrated, or an argument does not fit. Nothing has moved.
    CheckFailed
        If the doctor finds a fault before real arms move. Nothing has moved.
    HardwareError
        If a device failed, or no SMR is found. Nothing is stored.
    Cancelled
        Nothing is stored.
    """
    control = work.control
    cell_bodies(run.profile)  # a profile that lacks a pose is refused before minutes of computing
    probed = [name for name, arm in run.profile.arms.items() if arm.smr.probe is not None]
    state = RunState(run)
    checked = _checked(state, probed)
    design = design_of(checked.belief)
    chosen = _stops(run.profile, checked, design, request.most_stops)
    profile = _with_plant(profile_at_station(run, checked.stages), plant)
    test, excess_m = SequentialTest(design, len(chosen)), excess_of_readings(state, checked.model)
    notes: list[str] = []
    if checked.stale:
        notes.append(f"the model in force, that of '{checked.used.name}', was checked although {checked.stale}")

    opened = noting_controllers(run, notes)
    with running_job(run, control, "check"):
        confirm = confirmation(run.profile, work.ask(run.profile.name))
        with moving_cell(profile, checked.model, control, confirm=confirm, opened=opened) as mover:
            driven = drive_check(mover, checked.model, chosen, test.add, excess_m)
        control.tell("check", len(chosen), len(chosen), "done")
        result = _result(run, checked, driven, test.conclusion())
        result = result.model_copy(update={"notes": (*notes, *result.notes), "simulated": plant is not None})
        _store(run, checked, result)  # before the end is reported: listeners then read the run
    return result


def plant_of(path: Path) -> Plant:
    """Return the hidden physics of another profile. Raises ``InputError`` if it has none."""
    plant = load_profile(path).plant
    if plant is None:
        raise InputError(f"--simulated-plant {path}: this profile has no section 'plant'")
    return plant


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Checked:
    """The model to check and its data.

    ``used`` is the stage in force, ``arms`` the stage whose model is in the tracker frame of the readings.
    """

    stages: RunStages
    used: StoredStage
    arms: StoredStage
    model: CellModel
    belief: CheckBelief

    @property
    def stale(self) -> str:
        """Why the model did not hold even before the check, without what an earlier check found; empty if it held."""
        return "; ".join(filter(None, (self.stages.outdated_arms(), self.stages.outdated_station())))


def _checked(state: RunState, rotated: Collection[str] = ()) -> _Checked:
    """Read what is checked; arms ``rotated`` with orientation. Raises ``InputError`` if the run is not calibrated."""
    run, stages = state.run, state.stages
    used, arms = stage_in_force(run, stages), arms_stage(run, stages)
    readings = {name: known_readings(run, name) for name in run.profile.arms}
    located = LocateResult.from_json(used.text, f"{run.path}: {LOCATE}") if used.name == LOCATE else None
    belief = check_belief(run.profile, model_of(run, arms), readings, angular=rotated, located=located)
    return _Checked(stages, used, arms, model_of(run, used), belief)


def _with_plant(profile: Profile, plant: Plant | None) -> Profile:
    """Return the profile with other hidden physics; the tracker stays in place unless ``plant`` places it."""
    if plant is None:
        return profile
    own, simulated = profile.plant, all(arm.driver.needs_plant for arm in profile.arms.values())
    if own is None or not simulated or not profile.tracker.driver.needs_plant:
        raise InputError("check: --simulated-plant changes a simulated cell; this one is not simulated. Nothing moved")
    unknown = [name for name in plant.effects if name not in profile.arms]
    if unknown:
        raise InputError(f"check: --simulated-plant: plant.effects: unknown arm {', '.join(unknown)}")
    placed = plant.model_copy(update={"tracker_pose": plant.tracker_pose or own.tracker_pose}).after(own.earlier_jobs)
    return profile.model_copy(update={"plant": placed})


def _stops(profile: Profile, checked: _Checked, design: Design, count: int) -> list[dict[str, Readings]]:
    """Choose the stops to measure, arm -> its reading of the calibration, in the order of driving."""
    known = {name: arm.positions.readings for name, arm in checked.belief.arms.items()}
    candidates = check_candidates(profile, checked.model, known)
    order = choose_stops(design, candidates, count)
    return [{name: its.take([row]) for name, its in candidates.items()} for row in order.tolist()]


def _result(run: RunFile, checked: _Checked, driven: DrivenCheck, found: CheckResult) -> CheckResult:
    verdict = "not decided" if driven.lost and found.verdict == "valid" else found.verdict
    return found.model_copy(
        update={
            "verdict": verdict,
            "model": checked.used.name,
            "stops": tuple(_checked_stop(checked.model, stop) for stop in driven.stops),
            "seconds": driven.seconds,
            "stale": checked.stale,
            "next_step": _next_step(verdict, run.folder),
            "notes": (*driven.notes, *found.notes),
        }
    )


def _checked_stop(model: CellModel, stop: MeasuredStop) -> CheckedStop:
    points = points_of(list(stop.found.values()))
    expected = predicted_points(model, points)
    rotated = {name: _rotation_mrad(model.arms[name], one) for name, one in stop.found.items()}
    return CheckedStop.like(
        stop.state,
        points={
            name: CheckedPoint(
                q=tuple(own.q[0].tolist()),
                measured_M=xyz_of(own.p_M[0]),
                error_mm=float(np.linalg.norm(own.p_M[0] - expected[name][0])) * 1e3,
                error_mrad=rotated[name],
            )
            for name, own in points.items()
        },
        time_s=stop.time_s,
    )


def _rotation_mrad(arm: ArmModel, found: FoundPoint) -> float | None:
    """Return the angle [mrad] between measured and computed orientation; None if none was measured."""
    rotation = measured_rotation(arm, found.point, arm.flange(found.q[None], found.conditions)[0][0])
    return None if rotation is None else float(np.linalg.norm(rotation)) * 1e3


def _next_step(verdict: CheckVerdict, folder: Path) -> str:
    """Say what to do next, as a sentence with commands; empty if nothing."""
    again = (
        "measure the cell anew ('cellapp plan PROFILE --run NEW', 'cellapp collect NEW') and calibrate it with this run"
        f" as prior: 'cellapp calibrate NEW --prior {shell_word(folder)}'"
    )
    match verdict:
        case "valid":
            return ""
        case "tracker moved":
            return f"cellapp check {shell_word(folder)} --tracker-moved"
        case "base moved":
            return f"put the base back, or {again}"
        case "smr moved":
            return f"put the SMR back, or {again}"
        case "not decided":
            return f"mend what the notes say, then check again: 'cellapp check {shell_word(folder)}'"
        case _:
            return again


def _store(run: RunFile, checked: _Checked, result: CheckResult) -> None:
    """Store the result. A change of arms rests on the arms' stage: it stays valid if the tracker is located later."""
    used = checked.arms if result.verdict in CHANGES_OF_ARMS else checked.used
    append_stage(run, CHECK, result, basis_on_model(run, used))
    for line in (*result.complaints(), *result.notes):
        run.log("note" if result.verdict == "valid" else "warning", line)
