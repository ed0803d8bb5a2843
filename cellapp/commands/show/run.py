"""The verb ``show``: read what is stored; the run is opened read-only."""

from __future__ import annotations

from contextlib import suppress

from cellapp.cell.planning.view import check_plan_run, forecast_run
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import recording_states
from cellapp.commands.collect.state import collection_state
from cellapp.commands.compensate.target_list import stored_state
from cellapp.commands.plan.run import planned_stops
from cellapp.commands.record import Work
from cellapp.commands.registry import STORING, records
from cellapp.commands.run_state import RunState
from cellapp.commands.show.comparison import compare_runs
from cellapp.commands.show.overview import run_history, run_log, run_overview
from cellapp.commands.show.request import ShowRequest
from cellapp.commands.show.result import RecordingsResult, Shown
from cellapp.commands.show.view import profile_text
from cellapp.commands.stored_model import model_of, values_in_force
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.job_client import look_at_job, who_uses
from cellapp.ground.results import Result
from cellapp.ground.shell import filled, shell_word


def run(request: ShowRequest, work: Work) -> Shown:
    """Read the requested part, or compute what was requested of a plan."""
    with RunFile.open(request.folder) as opened:
        if request.against is not None:
            with RunFile.open(request.against) as other:
                return Shown(part="comparison", result=compare_runs(opened, other))
        state = RunState(opened)
        found = _found(state, request, work)
        return found.model_copy(update={"complaints": tuple(state.complaints)}) if request.strict else found


def _found(state: RunState, request: ShowRequest, work: Work) -> Shown:
    run = state.run
    match request.part:
        case "overview":
            result = run_overview(state)
            if job := _job_step(run):
                result = result.model_copy(update={"next_step": job, "next_verb": ""})
            return Shown(part=request.part, result=result)
        case "history":
            return Shown(part=request.part, result=run_history(state))
        case "plan":
            return Shown(part=request.part, result=_plan(run, request, work))
        case "collection":
            collected = collection_state(run, state.results)
            if collected is None:
                raise InputError(
                    f"{run.path}: no session of collecting is recorded; an import or an older version made this run"
                )
            return Shown(part=request.part, result=collected)
        case "recordings":
            return Shown(part=request.part, result=_recordings(run))
        case "log":
            return Shown(part=request.part, result=run_log(run, request.level, request.last))
        case "profile":
            return Shown(part=request.part, text=profile_text(run.profile))
    return _stored(state, request) if request.target is None else _target(state, request.target)


def _job_step(run: RunFile) -> str:
    """Say what to do with the job that uses the run now; empty if none does."""
    folder, seen = shell_word(run.folder), None
    with suppress(HardwareError, InputError):  # it is silent, of another account or another version
        seen = look_at_job(run.folder)
    if seen is None:
        used = who_uses(run.folder)
        return used and f"wait for {used}"
    if seen.request == "pause" or (seen.holds and seen.request == "stop"):
        state = "paused" if seen.request == "pause" else "stopped"
        return f"{seen.name} is {state}: 'cellapp job resume {folder}' continues, 'cellapp job abort {folder}' ends it"
    return f"wait for {seen.name}, which runs now ({seen.done} of {seen.total}); 'cellapp stop {folder}' stops it"


def _recordings(run: RunFile) -> RecordingsResult:
    if not (states := recording_states(run)):
        raise InputError(f"{run.path}: it holds no recording of motion; import with --joints and --points makes a run")
    return RecordingsResult(run=str(run.folder), recordings=states)


def _plan(run: RunFile, request: ShowRequest, work: Work) -> Result:
    if request.check:
        return check_plan_run(run, work.control)
    return forecast_run(run, work.control) if request.forecast else planned_stops(run)


def _target(state: RunState, name: str) -> Shown:
    """Return the last results on one target; the JSON is the result of ``compensate`` with only this target."""
    run, results = state.run, state.results
    target = stored_state(results, name)
    if target is None or results.compensate is None:
        raise InputError(
            f"{run.path}: no compensated target '{name}' is stored; 'cellapp show {shell_word(run.folder)}"
            " targets' lists them"
        )
    alone = results.compensate.model_copy(update={"targets": target.commands})
    return Shown(part="targets", result=alone, results=results)


def _stored(state: RunState, request: ShowRequest) -> Shown:
    """Return the stored result of one verb, and whether it still holds."""
    run, results = state.run, state.results
    verb, how = next((verb, how) for verb in records(STORING) for how in verb.stored if how.part == request.part)
    name = next((stage for stage in how.stages if getattr(results, stage) is not None), how.stages[-1])
    reason = {str(key): text for key, text in results.out_of_date.items()}.get(name, "")
    needs = (words for field, words in verb.request.asked() if verb.is_needed(field) or field == "folder")
    taken = (one.metavar if one.argument else f"{one.option} {one.metavar}" for one in needs)
    command = " ".join(["'cellapp", how.made_by or verb.name, *taken])
    made_by = filled(f"{command}'", {"DIR": run.folder})
    stored = getattr(results, name)
    if stored is None:
        why = f"{name} is stored, but {reason}" if reason else f"{how.missing} stored"
        driven = any(arm.driver.has_device for arm in run.profile.arms.values())
        lacks = verb.moves_arms and not driven
        raise InputError(f"{run.path}: {why}{'; these arms have no device' if lacks else f'; run {made_by} first'}")
    if request.part == "parameters" and (used := state.stages.in_force) is not None:
        stored = values_in_force(stored, model_of(run, used))
    return Shown(part=request.part, result=stored, out_of_date=reason, made_by=made_by)
