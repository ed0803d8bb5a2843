"""The verb ``push``: check the run, send commands, store the measurements even if the job is stopped."""

from __future__ import annotations

from contextlib import suppress

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.cell_checks import carrying, check_cell
from cellapp.cell.driving.requests import running_job
from cellapp.cell.driving.target_visit import push
from cellapp.cell.driving.verification import Findings, result_of
from cellapp.cell.run import RunFile
from cellapp.cell.targets.records import VerifyResult
from cellapp.commands.compensate.charts import target_charts
from cellapp.commands.compensate.run import compensated_commands, listed_targets
from cellapp.commands.compensate.tables import all_measured_tables, verification_tables
from cellapp.commands.compensate.words import push_lines, verify_lines
from cellapp.commands.confirm import confirmation
from cellapp.commands.push.request import PushRequest
from cellapp.commands.record import View, Work
from cellapp.commands.run_results import RunResults, evidence_of
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import append_stage, basis_on_model
from cellapp.commands.station import profile_at_station
from cellapp.commands.stored_model import model_of, require_current_model, require_own_factory, stage_in_force
from cellapp.commands.view.parts import Part
from cellapp.estimation.uncertainty.budget import Judge
from cellapp.ground.counting import counted
from cellapp.ground.errors import CellappError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled
from cellapp.ground.results import PUSH, VERIFY


def run(request: PushRequest, work: Work) -> VerifyResult:
    """Push the targets."""
    with (
        RunFile.open(request.folder, write=True) as opened,
        running_job(opened, work.control, request.job_name() or "push"),
    ):
        return push_targets(opened, request, work)


def push_targets(run: RunFile, request: PushRequest, work: Work) -> VerifyResult:
    """Compensate and push targets within a job that has locked the folder; if asked, measure them before and after.

    The model in force is used even if it, or a discovery, is out of date or a controller's own D-H has changed, only if
    the request says so; result and log then say it. A stopped job stores what it has measured.

    Raises
    ------
    InputError
        If the model is out of date and the operator does not insist, no target can be commanded, or the SMR mount in
        the profile is not the calibrated one. Nothing has moved.
    CheckFailed
        If the doctor finds a fault before real arms move. Nothing has moved.
    HardwareError
        If a device refused or failed, or a controller or its payload is not the calibrated one.
    Cancelled
    """
    state, targets = RunState(run), listed_targets(request.targets, run.profile)
    stages = state.stages
    require_own_factory(run, "push")
    if not request.out_of_date:
        require_current_model(run, stages, "push")
    commands, compensated = compensated_commands(run, stages, targets)
    # simulated cell: the tracker where it stands now
    profile = carrying(profile_at_station(run, stages), ((one.arm, one.payload_kg) for one in compensated.targets))
    used, visited = stage_in_force(run, stages), list[Findings]()
    judge, notes = judge_of(state, profile), [*compensated.notes]

    def opened(cell: Cell) -> None:
        notes.extend(check_cell(run, cell, commands, changed_controller=request.out_of_date))

    def store(pushed: VerifyResult) -> VerifyResult:
        said = [f"target {target.name}: {target.note}" for target in pushed.targets if target.note]
        result = pushed.model_copy(update={"notes": (*notes, *said), "common": compensated.common})
        if request.verify and not result.arms:  # it would take the place of an earlier verification that holds
            kept = "no target was measured; nothing is stored, an earlier verification still counts"
            return result.model_copy(update={"notes": (*result.notes, kept)})
        append_stage(run, VERIFY if request.verify else PUSH, result, basis_on_model(run, used, targets))
        return result

    try:
        pushed = push(
            profile,
            model_of(run, used),
            commands,
            work.control,
            verify=request.verify,
            rounds=request.iterate or 0,
            repeatability_m=_repeatability_m(state.results),
            judge=judge,
            confirm=confirmation(run.profile, work.ask(run.profile.name)),
            opened=opened,
            visited=visited,
        )
    except (CellappError, Cancelled) as error:
        if visited:
            asked = len({one.target.name for one in commands})
            stopped = f"stopped after {len(visited)} of {counted(asked, 'target')}: {error}"
            with suppress(InputError):  # report the reason of the halt, not this error
                store(result_of(visited, judge, stopped, verify=request.verify))
        raise
    return store(pushed)


def judge_of(state: RunState, profile: Profile) -> Judge:
    """Return the judge of a run's tolerances, with the uncertainty from its results and readings."""
    arms = {name: evidence_of(state.results, name, state.measured.get(name)) for name in profile.arms}
    return Judge(profile, arms)


def _repeatability_m(results: RunResults) -> dict[str, float]:
    """Return each arm's standard deviation of a coordinate over repeated stops [m], tracker included, if known."""
    return {
        name: arm.repeatability_mm.coordinate * 1e-3
        for name, arm in ({} if results.calibrate is None else results.calibrate.arms).items()
        if arm.repeatability_mm is not None
    }


_HELD = "the verification held"


def view(result: VerifyResult, request: PushRequest | None = None) -> View:
    """Show what was reached and measured; of a stored verification every target, with charts.

    Only a push that measures can fail.
    """
    if request is None:
        charts = target_charts(result, dict.fromkeys(result.arms))
        return View((*all_measured_tables(result), *verify_lines(result), *charts), result.complaints(), held=_HELD)
    parts: tuple[Part, ...] = (*verification_tables(result), *push_lines(result))
    return View(parts, result.complaints(), held=_HELD) if request.verify else View(parts)
