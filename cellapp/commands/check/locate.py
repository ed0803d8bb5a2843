"""Of the verb ``check``: after a move of the tracker, restore the calibration of a run from a few measured points."""

from __future__ import annotations

import math

import numpy as np

from cellapp.cell.driving.cell_checks import noting_controllers
from cellapp.cell.driving.locate import LocatedStation, locate_station
from cellapp.cell.driving.requests import running_job
from cellapp.cell.driving.supervision import moving_cell
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import known_readings
from cellapp.commands.check.request import CheckRequest
from cellapp.commands.confirm import confirmation
from cellapp.commands.record import Work, six_numbers
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import RunStages, StoredStage, append_stage, basis_on_model, read_stages
from cellapp.commands.station import excess_of_readings, last_location, profile_at_station
from cellapp.commands.stored_model import append_with_model, arms_stage, export_model, model_of
from cellapp.estimation.calibration.station_location import displacement_m
from cellapp.estimation.monitoring.records import LocatedPoint, LocateResult, StationPose
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Pose, Profile
from cellapp.ground.results import LOCATE
from cellapp.ground.shell import shell_word
from cellapp.robot.effects import EFFECTS, EffectTerm
from cellapp.robot.effects.law import InputVariable
from cellapp.robot.kinematics.transforms import Array, invert, rotation_vectors, rows_of, rpy_of, twist_columns, xyz_of
from cellapp.robot.model import CellModel
from cellapp.robot.model.model import relocated
from cellapp.robot.model.nominal import pose_matrix


def locate_run(
    run: RunFile,
    request: CheckRequest,
    work: Work,
    *,
    tracker_pose: Pose | None = None,
    simulated_pose: Pose | None = None,
) -> LocateResult:
    """Measure points of the arms from the tracker's present station, and store the model in its frame.

    ``tracker_pose`` is the rough pose of the tracker in the cell frame, by default the last located one, or that in
    the profile. ``simulated_pose`` first moves the tracker of a simulated cell, for this and later jobs in this run.
    If the points do not fit, the result says why and has no model.

    Raises
    ------
    InputError
        If the run has no calibration that can be transformed, or an argument does not fit. Nothing has moved.
    CheckFailed
        If the doctor finds a fault before real arms move. Nothing has moved.
    HardwareError
        If a device failed, or the SMRs are not found from the assumed station. Nothing is stored.
    Cancelled
        Nothing is stored.
    """
    control, state = work.control, RunState(run)
    stages = state.stages
    used = _stage_before_moving(run, stages)
    profile, model = profile_at_station(run, stages, simulated_pose), model_of(run, used)
    rough_T, excess_m = _rough_station(run, stages, tracker_pose), excess_of_readings(state, model)
    candidates = {name: known_readings(run, name).q for name in run.profile.arms}
    notes: list[str] = []
    opened = noting_controllers(run, notes)
    with running_job(run, control, "locate"):
        confirm = confirmation(run.profile, work.ask(run.profile.name))
        with moving_cell(profile, model, control, confirm=confirm, opened=opened, slow_visits=None) as mover:
            found = locate_station(mover, model, rough_T, candidates, excess_m, request.most_stops)
        control.tell("locate", len(found.found), len(found.found), "done")
        result = _result(profile, model, found, (*notes, *found.notes))
        moved = relocated(model, found.fit.T_new_old, found.fit.twists) if found.fit.explains else None
        _store(run, used, result, moved)  # before the end is reported: listeners then read the run
    return result


def typed_pose(text: str, what: str) -> Pose:
    """Parse a pose ``x,y,z,roll,pitch,yaw`` [m, deg]. Raises ``InputError``, which begins with ``what``."""
    expected = "x,y,z,roll,pitch,yaw in m and deg, as 3.8,0.1,0.6,0,0,180"
    x, y, z, roll, pitch, yaw = six_numbers(what, text, expected)
    return Pose(position=(x, y, z), rpy=(math.radians(roll), math.radians(pitch), math.radians(yaw)))


# -- inside -----------------------------------------------------------------------------------------------------------


def _stage_before_moving(run: RunFile, stages: RunStages) -> StoredStage:
    """Return the stage whose model is in the tracker frame of the readings; refuse one that is out of date."""
    used = arms_stage(run, stages)
    stale = "; ".join(f"'{n}' is out of date ({r})" for n, r in stages.out_of_date.items() if n == used.name)
    if stale:
        raise InputError(f"check: {stale}; nothing was moved. Run 'cellapp {used.name} {shell_word(run.folder)}' first")
    return used


def _rough_station(run: RunFile, stages: RunStages, tracker_pose: Pose | None) -> Array:
    """Guess ``T_new_old`` (4, 4) from the given pose, else from the last location of the tracker."""
    pose = run.profile.tracker.pose
    if pose is None:
        raise InputError(f"profile {run.profile.name}: tracker.pose is needed to point the tracker")
    if tracker_pose is not None:
        return np.asarray(invert(pose_matrix(tracker_pose)) @ pose_matrix(pose))
    last = last_location(run, stages)
    return np.eye(4) if last is None else np.array(last.T_new_old)


def _result(profile: Profile, model: CellModel, found: LocatedStation, notes: tuple[str, ...]) -> LocateResult:
    fit, pose = found.fit, profile.tracker.pose
    assert pose is not None
    T_C_M = pose_matrix(pose) @ invert(fit.T_new_old)
    old_station = invert(fit.T_new_old)[:3, 3]
    moved = displacement_m(model, found.points, fit.T_new_old) > profile.collection.reference.drift
    plant = profile.plant
    placed = None if plant is None or plant.tracker_pose is None else plant.tracker_pose
    rows = {name: iter(own) for name, own in fit.residuals.items()}
    return LocateResult(
        verdict="located" if found.fit.explains else "not explained",
        moved=moved,
        T_new_old=rows_of(fit.T_new_old),
        shift_mm=float(np.linalg.norm(old_station)) * 1e3,
        turn_deg=float(np.degrees(np.linalg.norm(rotation_vectors(fit.T_new_old[None, :3, :3])[0]))),
        covariance=rows_of(fit.covariance),
        uncertainty_mm=_added_mm(found),
        rms_mm=fit.rms_m * 1e3,
        chi_squared=fit.chi_squared,
        degrees_of_freedom=fit.degrees_of_freedom,
        probability=fit.probability,
        tracker_pose=StationPose(position=xyz_of(T_C_M[:3, 3]), rpy=rpy_of(T_C_M[:3, :3])),
        simulated_pose=None if placed is None else StationPose(position=placed.position, rpy=placed.rpy),
        carried=all(arm.posterior is not None for arm in model.arms.values()),
        points=tuple(
            LocatedPoint(
                arm=one.arm,
                q=tuple(one.q.tolist()),
                measured_M=xyz_of(one.point.p_M),
                residual_mm=xyz_of(next(rows[one.arm]) * 1e3),
                found_off_mm=one.found_off_m * 1e3,
            )
            for one in found.found
        ),
        notes=(*notes, *_station_notes(model, found, moved=moved), *_model_notes(model)),
    )


def _store(run: RunFile, used: StoredStage, result: LocateResult, moved: CellModel | None) -> None:
    basis = basis_on_model(run, used)
    assert basis is not None
    if moved is None:
        append_stage(run, LOCATE, result, basis)
    else:
        append_with_model(run, LOCATE, result, moved, basis)
        export_model(run, read_stages(run))
    for line in (*result.complaints(), *result.notes):
        run.log("warning" if result.verdict != "located" else "note", line)


def _station_notes(model: CellModel, found: LocatedStation, *, moved: bool) -> list[str]:
    """Return notes on a located station for the operator."""
    if not found.fit.explains:
        return []
    notes = [
        f"arm {name} was not measured: that its base and SMR are where they were is taken for granted"
        for name in model.arms
        if name not in found.points
    ]
    if moved:
        notes.append(
            "targets and work frames in the tracker's frame are taken in its new frame from now on: measure those that"
            " were measured from the old station again"
        )
    if moved and len(model.arms) == 1:
        notes.append("one arm does not show whether the tracker was moved or its own base; the model holds either way")
    return notes


def _model_notes(model: CellModel) -> list[str]:
    """Return notes on what the located model does not state."""
    notes = [
        f"arm {name}: the calibration states no uncertainty of its own, so the station's is not carried on either; run"
        " 'cellapp discover DIR' for both"
        for name, arm in model.arms.items()
        if arm.posterior is None
    ]
    for name, arm in model.arms.items():
        seen = [term.slug for term in arm.effects if _is_of_view(term)]
        if seen:
            notes.append(
                f"arm {name}: {', '.join(seen)} depend on where the tracker sees the SMR; from the new station they are"
                " extrapolated"
            )
    return notes


def _is_of_view(term: EffectTerm) -> bool:
    variables = term.law.form.variables or EFFECTS[term.slug].variables
    return bool(variables & {InputVariable.BEAM, InputVariable.INCIDENCE})


def _added_mm(found: LocatedStation) -> float:
    """Return the standard deviation of a coordinate from the station alone, rms over the points [mm]."""
    J = twist_columns(np.array([one.point.p_M for one in found.found]))
    variance = np.einsum("nai,ij,naj->na", J, found.fit.covariance, J)
    return float(np.sqrt(variance.mean())) * 1e3
