"""The verb ``follow``: plan paths with the model in force; on request drive and verify them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.controllers import noting_controllers
from cellapp.cell.driving.following import follow
from cellapp.cell.driving.loads import carrying, require_known_loads
from cellapp.cell.driving.requests.running import running_job
from cellapp.cell.run import RunFile
from cellapp.cell.targets.path_file import PathSpec, load_paths
from cellapp.cell.targets.path_records import DrivenPath, PathResult
from cellapp.cell.targets.path_result import path_csv, path_result
from cellapp.cell.targets.plan_path import PathPlan, path_payload, plan_path
from cellapp.commands.confirm import Ask, confirmation
from cellapp.commands.follow.request import FollowRequest
from cellapp.commands.locate.station import profile_at_station
from cellapp.commands.push.run import judge_of
from cellapp.commands.record import Work
from cellapp.commands.stages import append_stage, basis_on_model, read_stages
from cellapp.commands.stored_model import model_of, require_current_model, stage_in_force, stale_notes
from cellapp.ground.control import JobControl
from cellapp.ground.outputs import NEW_ONLY, Outputs
from cellapp.ground.pace import with_eta
from cellapp.ground.progress import Listener, Progress, ignore
from cellapp.ground.results import FOLLOW, PATH
from cellapp.robot.model import CellModel

Driving = Literal["plan", "drive", "verify"]
"""Plan only, without motion; drive; drive and measure."""
_PERIOD_S = 0.008
"""Period of a plan that is not driven [s], that of the slower UR controllers. Driving replans with the arm's own."""


def run(request: FollowRequest, work: Work) -> PathResult:
    """Plan paths; drive and measure them on request."""
    with RunFile.open(request.folder, write=True) as opened:
        return follow_run(
            opened,
            load_paths(request.path, opened.profile, request.arm),
            work.listener,
            work.control,
            driving="verify" if request.verify else "drive" if request.drive else "plan",
            rehearse=request.rehearse,
            out_of_date=request.out_of_date,
            csv=request.out,
            outputs=work.outputs,
            ask=work.ask(opened.profile.name) if request.moves() else None,
        )


def follow_run(
    run: RunFile,
    paths: Sequence[PathSpec],
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    driving: Driving = "plan",
    rehearse: bool = False,
    out_of_date: bool = False,
    csv: Path | None = None,
    outputs: Outputs = NEW_ONLY,
    ask: Ask | None = None,
) -> PathResult:
    """Plan paths and store the result; with ``driving`` also drive them, and measure the path errors.

    ``rehearse`` drives each path once beforehand and corrects it by the joints' lag. ``out_of_date`` uses the model in
    force even if it, or a discovery, is out of date. ``csv`` is a file for the joint positions; ``outputs`` says what
    it may replace. ``ask`` is called before the first motion of real arms.

    Raises
    ------
    InputError
        If the model is out of date and the operator does not insist, no path can be driven, or ``csv`` cannot be
        written. Nothing has moved.
    CheckFailed
        If the doctor finds a fault before real arms move. Nothing has moved.
    HardwareError
        If a device refused or failed, or a controller has another payload than a path requires.
    Cancelled
    """
    control = control or JobControl()
    stages = read_stages(run)
    if driving != "plan" and not out_of_date:
        require_current_model(run, stages, "follow")
    used = stage_in_force(run, stages)
    model, notes = model_of(run, used), stale_notes(stages, used)
    plans = _planned(run, model, paths, listener, control)
    if csv is not None:
        outputs.write_text(csv, path_csv(plans))
    followed: list[tuple[PathPlan, DrivenPath | None]] = [(plan, None) for plan in plans]
    with ExitStack() as stack:
        if driving != "plan":
            listener = stack.enter_context(running_job(run, control, "follow", listener))
            loads = [(plan.spec.arm, path_payload(run.profile, plan.spec)) for plan in plans]
            profile = carrying(profile_at_station(run, stages), loads)  # a simulated tracker where it stands now

            def opened(cell: Cell) -> None:
                noting_controllers(run, notes, insist=out_of_date)(cell)
                require_known_loads(cell, loads)

            followed = follow(
                profile,
                model,
                plans,
                with_eta(listener),
                control,
                verify=driving == "verify",
                rehearse=rehearse,
                judge=judge_of(run, profile),
                confirm=confirmation(run.profile, ask),
                opened=opened,
            )
        result = path_result(model, followed, notes)
        basis = basis_on_model(run, used, paths)
        # before the end is reported: listeners then read the run
        append_stage(run, FOLLOW if driving == "verify" else PATH, result, basis)
    return result


def _planned(
    run: RunFile, model: CellModel, paths: Sequence[PathSpec], listener: Listener, control: JobControl
) -> list[PathPlan]:
    plans = []
    for done, spec in enumerate(paths):
        control.check()
        listener(Progress("plan paths", done, len(paths), spec.name))
        plans.append(plan_path(run.profile, model, spec, _PERIOD_S))
    listener(Progress("plan paths", len(paths), len(paths), "done"))
    return plans
