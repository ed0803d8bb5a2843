"""The verb ``iso9283``: performance tests by ISO 9283, and additional ones between two arms."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from cellapp.cell.driving.cell_checks import noting_controllers
from cellapp.cell.driving.iso9283.tests import (
    DWELL_S,
    IsoFindings,
    IsoTask,
    arm_results,
    drive_tests,
    lost_beam_words,
    missing_words,
    pair_results,
)
from cellapp.cell.driving.requests import running_job
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.csv_text import table_text
from cellapp.commands.confirm import confirmation
from cellapp.commands.iso9283.request import Iso9283Request
from cellapp.commands.judgements import judge_characteristics
from cellapp.commands.plan.run import default_folder
from cellapp.commands.record import Work
from cellapp.commands.stages import RunStages, StoredStage, append_stage, basis_of, basis_on_model, read_stages
from cellapp.commands.station import profile_at_station
from cellapp.commands.stored_model import model_of, require_current_model, stale_notes
from cellapp.estimation.iso9283.coverage import coverage
from cellapp.estimation.iso9283.evaluate import HEADER, raw_rows
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, ISO_TESTS, NORM_CYCLES, NORM_DRIFT_MIN, IsoCommands
from cellapp.estimation.iso9283.records import Iso9283Result, IsoConditions
from cellapp.ground.counting import counted
from cellapp.ground.errors import CellappError, InputError
from cellapp.ground.outputs import NEW_ONLY
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled
from cellapp.ground.results import ISO9283
from cellapp.ground.shell import shell_word

_NO_ORIENTATION = (
    "positions only: one SMR on each flange shows nothing of the norm's characteristics of orientation (AP and RP of"
    " the angles)"
)
_SEED = 0x9283
_POINTS = "iso9283-points"


def run(request: Iso9283Request, work: Work) -> Iso9283Result:
    """Make tests in the run of a folder; of nominal commands also in a new run."""
    profile, folder = None if request.profile is None else load_profile(request.profile), request.folder
    if folder is None:
        assert profile is not None  # the request has folder or profile
        if not request.nominal:
            raise InputError(
                f"iso9283: whose calibration is tested? Give its run with --run DIR, or --nominal to test the arms of"
                f" '{profile.name}' as they are, by the published geometry. Nothing was moved"
            )
        folder = default_folder(profile.name)
        work.say(f"stored in {folder}")
    with opened_run(folder, profile, new=request.nominal) as opened:
        return iso9283_run(opened, request, work)


def iso9283_run(run: RunFile, request: Iso9283Request, work: Work) -> Iso9283Result:
    """Make tests of ISO 9283 in a run and store the result; of a stopped job, what was measured until then.

    By default commands are of both kinds in a calibrated run, else nominal; base and SMR of each arm are then found
    first.

    Raises
    ------
    InputError
        If the request does not fit the run, or the model is out of date and the operator does not insist. Nothing has
        moved.
    CheckFailed
        If the doctor finds a fault before real arms move. Nothing has moved.
    HardwareError
        If a device refused or failed.
    Cancelled
    """
    control, stages = work.control, read_stages(run)
    used = stages.in_force
    kinds = _commands(run, request, calibrated=used is not None)
    named = _arms(run.profile, request.arms)
    if request.tests == ("cooperative",) and len(named) < 2:
        raise InputError("iso9283: a cooperative test needs two arms; this cell, or --arm, has one")
    if used is not None and not request.out_of_date:
        require_current_model(run, stages, "iso9283")
    task = _task(run, request, stages, kinds, named)
    with running_job(run, control, "iso9283"):
        confirm = confirmation(run.profile, work.ask(run.profile.name))
        findings, began = IsoFindings(notes=_notes(task, stages, used)), datetime.now(UTC).isoformat(timespec="seconds")
        opened = noting_controllers(run, findings.notes, insist=request.out_of_date)
        try:
            drive_tests(task, findings, control, confirm=confirm, opened=opened)
        except (CellappError, Cancelled) as error:
            if findings.measured.visits or findings.paths:
                with suppress(InputError):  # report the reason of the halt, not this error
                    _store(run, used, _result(task, findings, began, f"stopped: {error}"), findings)
            raise
        return _store(run, used, _result(task, findings, began, ""), findings)


def opened_run(folder: Path, profile: Profile | None, *, new: bool) -> RunFile:
    """Open the run in a folder for writing; if ``new`` and the folder holds none, make one without a plan.

    Raises ``InputError`` if the folder holds no run, or one of another cell than that of ``profile``.
    """
    if not (folder / "run.sqlite").exists():
        if new and profile is not None:
            return RunFile.create(folder, profile)
        raise InputError(
            f"{folder} holds no run whose calibration could be tested: give that of a calibrated run with --run, or"
            " PROFILE and --nominal to test the arms as they are. Nothing was moved"
        )
    run = RunFile.open(folder, write=True)
    for section in ("arms", "tracker", "obstacles"):
        if profile is not None and getattr(run.profile, section) != getattr(profile, section):
            run.close()
            raise InputError(
                f"{run.path}: its profile differs from '{profile.name}' in section '{section}': it is a run of another"
                " cell, or of this one before it was changed. Give a new folder, or the run's own profile"
            )
    return run


# -- inside -----------------------------------------------------------------------------------------------------------


def _task(
    run: RunFile, request: Iso9283Request, stages: RunStages, kinds: tuple[IsoCommands, ...], named: tuple[str, ...]
) -> IsoTask:
    """Build the task: ``kinds`` of commands, the arms ``named``."""
    used = stages.in_force
    return IsoTask(
        profile=profile_at_station(run, stages),
        model=None if used is None else model_of(run, used),
        commands=kinds,
        tests=tuple(test for test in ISO_TESTS if test in request.tests),
        arms=named,
        cycles=request.cycles,
        speed=request.speed / 100.0,
        drift_s=request.drift_minutes * 60.0,
        also_speeds=tuple(one / 100.0 for one in dict.fromkeys(request.also_speeds) if one != request.speed),
    )


def _commands(run: RunFile, request: Iso9283Request, *, calibrated: bool) -> tuple[IsoCommands, ...]:
    """Return the kinds of commands: those asked for, else both. Raises ``InputError`` without the calibration asked."""
    asked = ("nominal",) if request.nominal else request.commands or ISO_COMMANDS
    if "calibrated" in asked and not calibrated:
        raise InputError(
            f"iso9283: {run.folder} is not calibrated: 'cellapp calibrate {shell_word(run.folder)}' first, or"
            " add --nominal to test"
            " the arms as they are, by the published geometry. Nothing was moved"
        )
    return tuple(kind for kind in ISO_COMMANDS if kind in asked)


def _arms(profile: Profile, names: Sequence[str]) -> tuple[str, ...]:
    for name in names:
        if name not in profile.arms:
            raise InputError(f"iso9283: no arm '{name}'; arms are {', '.join(profile.arms)}")
    for name, arm in profile.arms.items():
        if arm.home is None:
            raise InputError(f"profile {profile.name}: arms.{name}.home is needed: an arm waits there for the others")
    return tuple(name for name in profile.arms if name in names or not names)


def _notes(task: IsoTask, stages: RunStages, used: StoredStage | None) -> list[str]:
    """Return notes on the conditions of the tests."""
    notes: list[str] = []
    if used is None:
        notes.append(
            "the run is not calibrated: base and SMR of each arm were fitted to positions that the published geometry"
            " does not meet exactly; the uncertainty of that fit is in the uncertainty of AP and AD"
        )
    else:
        notes += stale_notes(stages, used)
    if task.profile.is_simulated:
        notes.append("measured in a simulated cell")
    if short := [NORM_CYCLES[test] for test in task.tests if task.cycles < NORM_CYCLES[test]]:
        notes.append(f"{counted(task.cycles, 'cycle was', 'cycles were')} asked for; the norm's number is {max(short)}")
    if "cooperative" in task.tests and len(task.arms) < 2:
        notes.append("no cooperative test was made: it needs two arms")
    if "drift" in task.tests and task.drift_s < NORM_DRIFT_MIN * 60.0:
        notes.append(f"drift was observed for {task.drift_s / 60.0:g} min; the norm's time is {NORM_DRIFT_MIN:g} min")
    return notes


def _result(task: IsoTask, found: IsoFindings, began: str, stopped: str) -> Iso9283Result:
    profile, rng = task.profile, np.random.default_rng([task.profile.seed, _SEED])
    arms, pairs = arm_results(task, found, rng), pair_results(found, rng)
    angles = any(one.orientations for one in found.measured.visits)
    air = [one.temperature_c for one in found.measured.visits if one.temperature_c is not None]
    conditions = IsoConditions.like(
        task,
        speed_share=task.speed,
        dwell_s=DWELL_S,
        averaging_s=profile.tracker.averaging,
        began=began,
        seconds=found.seconds,
        temperature_c=(min(air), max(air)) if air else None,
    )
    return Iso9283Result(
        tests=task.tests,
        arms=arms,
        pairs=pairs,
        conditions=conditions,
        judgements=judge_characteristics(profile.tolerances, arms, pairs, task.cycles),
        coverage=coverage(task.tests, arms, conditions, stopped),
        missing=missing_words(found, task.tests),
        stopped=stopped,
        notes=tuple(dict.fromkeys([*([] if angles else [_NO_ORIENTATION]), *found.notes, *lost_beam_words(found)])),
    )


def _store(run: RunFile, used: StoredStage | None, result: Iso9283Result, found: IsoFindings) -> Iso9283Result:
    """Write the raw points beside the run, then append the result, also if the points cannot be written."""
    try:
        name, digest = _write_points(run.folder, found)
        result = result.model_copy(update={"points_file": name, "points_sha256": digest})
    except InputError as error:
        result = result.model_copy(update={"notes": (*result.notes, f"the measured points were not kept: {error}")})
    append_stage(run, ISO9283, result, basis_of(run) if used is None else basis_on_model(run, used))
    return result


def _write_points(folder: Path, found: IsoFindings) -> tuple[str, str]:
    """Write all measured points into a new file of the folder; return its name and SHA-256, both empty without points.

    Other programs can recompute all figures of a test from it. Raises ``InputError`` if it cannot be written.
    """
    if not found.measured.visits and not any(runs.tracks for runs in found.paths):
        return "", ""
    data = table_text(HEADER, raw_rows(found.programmes, found.measured, found.paths)).encode()
    path, number = folder / f"{_POINTS}.csv", 1
    while path.exists():  # a run keeps the points of each of its tests
        number += 1
        path = folder / f"{_POINTS}-{number}.csv"
    NEW_ONLY.write(path, data)
    return path.name, hashlib.sha256(data).hexdigest()
