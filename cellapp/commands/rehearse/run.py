"""The verb ``rehearse``: drive one rung of a profile's rehearsal, and record it beside the profile."""

from __future__ import annotations

from pathlib import Path

from cellapp.cell.driving.motion import Confirm
from cellapp.cell.driving.records import RehearseResult
from cellapp.cell.driving.rehearsal import rehearse
from cellapp.cell.driving.rehearsal_rungs import RUNGS, RungName
from cellapp.cell.driving.requests import running_job
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.file import note_profile
from cellapp.commands.confirm import first_path_words, require_permission
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.record import Ask, Work
from cellapp.commands.rehearse.request import RehearseRequest
from cellapp.commands.rehearse.result import missing_rungs, read_log, write_log
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile


def run(request: RehearseRequest, work: Work) -> RehearseResult:
    """Drive the requested rung, or the first missing one."""
    path, profile = request.profile, load_profile(request.profile)
    _require_controllers(profile)
    log = read_log(path, profile)
    missing = missing_rungs(log)
    name = request.rung or (missing[0] if missing else "both-arms")
    arms = _arms(profile, name, request.arm)
    rungs = list(RUNGS)
    if before := [one for one in missing if rungs.index(one) < rungs.index(name)]:
        work.say(f"rehearse: not passed yet before '{name}': {', '.join(before)}")
    folder = request.run_folder or path.with_name(f"{path.stem}-rehearsal")
    with _planned(folder, profile, work) as opened:
        note_profile(opened, path)
        confirm = _confirmation(profile, work.ask(profile.name), name)
        with running_job(opened, work.control, "rehearse"):
            result = rehearse(opened, name, arms, work.control, confirm)
    log = log.model_copy(update={"rungs": {**log.rungs, name: result}})
    result = result.model_copy(update={"missing": missing_rungs(log)})
    write_log(path, log)
    return result


def _require_controllers(profile: Profile) -> None:
    """Raise ``InputError`` unless every arm has a controller for the rehearsal."""
    without = [name for name, arm in profile.arms.items() if not arm.driver.has_device or arm.driver.needs_plant]
    if without:
        raise InputError(
            f"rehearse: arm {', '.join(without)} of {profile.name} has no controller (driver '"
            f"{profile.arms[without[0]].driver.kind}'); nothing to rehearse. Simulated cells are collected at once"
        )


def _arms(profile: Profile, name: RungName, asked: str | None) -> tuple[str, ...]:
    if asked is not None and asked not in profile.arms:
        raise InputError(f"rehearse: --arm {asked}: no such arm; arms are {', '.join(profile.arms)}")
    if not RUNGS[name].one_arm:
        if asked is not None:
            raise InputError(f"rehearse: --arm {asked}: '{name}' drives all arms; leave it out")
        return tuple(profile.arms)
    return (asked or next(iter(profile.arms)),)


def _planned(folder: Path, profile: Profile, work: Work) -> RunFile:
    """Open or make the run whose plan is driven. Raises ``InputError`` if it is of another cell."""
    if not (folder / "run.sqlite").exists():
        return new_planned_run(profile, folder, work.control)
    found = RunFile.open(folder, write=True)
    if found.profile.arms != profile.arms or found.profile.obstacles != profile.obstacles:
        found.close()
        raise InputError(
            f"{folder}: its plan is of other arms or obstacles than {profile.name} has now; give another run, or move"
            " this one away"
        )
    return found


def _confirmation(profile: Profile, ask: Ask | None, name: RungName) -> Confirm | None:
    """Return what asks a person before the first motion of controllers on other computers; None if nobody is asked."""
    require_permission(profile, ask)
    if ask is None or not profile.moves_hardware:
        return None
    return lambda start, targets: ask(f"Rehearse {RUNGS[name].words}.\n{first_path_words(profile, start, targets)}")
