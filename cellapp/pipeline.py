"""The whole spine in one call, from profile to report. CLI and TUI call this."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from cellapp.calibration.calibrate import CALIBRATION_FILE, RESULT, calibrate_run
from cellapp.collection.cell import Cell
from cellapp.collection.collect import collect_run
from cellapp.collection.controllers import check_controllers
from cellapp.compensation.compensate import as_dict as compensate_dict
from cellapp.compensation.compensate import compensate
from cellapp.compensation.push import push
from cellapp.compensation.targets import Target, load_targets
from cellapp.discovery.discover import DISCOVER_RESULT, discover_run
from cellapp.model import CellModel
from cellapp.planning.plan import plan_run
from cellapp.profile import Profile, load_profile
from cellapp.progress import CancelToken, Listener, ignore
from cellapp.reporting.page import write_page
from cellapp.run import RunFile

VERIFY_RESULT = "verify"
COMPENSATE_RESULT = "compensate"
PUSH_RESULT = "push"
"""What was pushed without a verification; it does not replace one."""


@dataclass(frozen=True)
class Outcome:
    """What a whole run ended with.

    Attributes
    ----------
    folder : Path
        Of the run.
    results : mapping
        Step -> the object that its ``--json`` writes.
    notes : tuple of str
        What a person should know beside the numbers.
    """

    folder: Path
    results: Mapping[str, Mapping[str, Any]]
    notes: tuple[str, ...]


def default_folder(profile_name: str) -> Path:
    """A new folder below ``logs`` in the working directory, named after the profile and the time."""
    return Path("logs") / f"{profile_name}-{datetime.now():%Y%m%d-%H%M%S}"


def run_whole(
    profile_path: Path, folder: Path | None, listener: Listener = ignore, cancel: CancelToken | None = None
) -> Outcome:
    """Everything, unattended.

    Raises
    ------
    CellappError
        Bad input, a device that refused, in words.
    Cancelled
        On request; the run file keeps all that was committed and can be resumed.
    """
    cancel = cancel or CancelToken()
    profile = load_profile(profile_path)
    targets: tuple[Target, ...] = ()
    if profile.targets is not None:  # read now: a misspelt list should not show after hours of measuring
        targets = load_targets(profile_path.parent / profile.targets, profile)
    folder = folder or default_folder(profile.name)
    notes: list[str] = []
    with new_planned_run(profile, folder, listener, cancel) as run:
        notes += collect_run(run, listener, cancel)
        calibration = calibrate_run(run, listener, cancel)
        notes += calibration.notes
        discover_run(run, listener, cancel)
        if targets:
            notes += push_run(run, targets, listener, cancel, verify=True)
        write_page(run)
        return Outcome(folder, stored_results(run), tuple(notes))


def new_planned_run(
    profile: Profile, folder: Path, listener: Listener = ignore, cancel: CancelToken | None = None
) -> RunFile:
    """A new run with its plan. Where there is no plan to be had, or on request, nothing is left behind.

    Raises
    ------
    InputError
        As ``RunFile.create`` and ``plan_run`` do.
    Cancelled
    """

    def fill(run: RunFile) -> None:
        plan_run(run, listener, cancel)

    return RunFile.create(folder, profile, fill)


def compensate_run(run: RunFile, targets: tuple[Target, ...]) -> dict[str, Any]:
    """Compute and store commands for targets. Returns the object that ``compensate --json`` writes."""
    model = CellModel.load(run.folder / CALIBRATION_FILE)
    result = dict(compensate_dict(compensate(run.profile, model, targets)))
    run.write_result(COMPENSATE_RESULT, json.dumps(result))
    return result


def push_run(
    run: RunFile,
    targets: tuple[Target, ...],
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    *,
    verify: bool,
) -> tuple[str, ...]:
    """Compensate and push targets, store what was measured. Returns notes on targets that were left out.

    Whether a verification held is told by ``unverified`` from the stored result.
    """
    model = CellModel.load(run.folder / CALIBRATION_FILE)
    commands = compensate(run.profile, model, targets)
    run.write_result(COMPENSATE_RESULT, json.dumps(compensate_dict(commands)))
    notes: list[str] = []

    def opened(cell: Cell) -> None:
        notes.extend(check_controllers(run, cell).notes)

    verification = push(run.profile, model, commands, listener, cancel, verify=verify, opened=opened)
    run.write_result(VERIFY_RESULT if verify else PUSH_RESULT, json.dumps(verification.as_dict()))
    notes += [f"target {target.name}: {target.note}" for target in verification.targets if target.note]
    return tuple(notes)


def stored_results(run: RunFile) -> dict[str, dict[str, Any]]:
    """The results that a run holds, by step."""
    results = {}
    for step in (RESULT, DISCOVER_RESULT, COMPENSATE_RESULT, PUSH_RESULT, VERIFY_RESULT):
        text = run.read_result(step)
        if text is not None:
            results[step] = json.loads(text)
    return results
