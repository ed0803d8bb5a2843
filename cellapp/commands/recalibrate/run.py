"""The verb ``recalibrate``: recompute every run of a fleet whose calibration or discovery is out of date.

Each run is one task. Its worker appends the results to the run itself, as ``calibrate`` and ``discover`` do: workers of
a cluster must see the folders under the same path, on a file system that supports the locks of SQLite.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.prior_source import recorded_priors
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.commands.recalibrate.request import RecalibrateRequest
from cellapp.commands.recalibrate.result import RecalibratedRun, RecalibrateResult
from cellapp.commands.record import Work
from cellapp.commands.runs.history import check_folder, run_folders
from cellapp.commands.stages import read_stages
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.ground.asking import who_uses
from cellapp.ground.errors import InputError
from cellapp.ground.executors import Work as Computing
from cellapp.ground.executors import gather
from cellapp.ground.results import CALIBRATE, DISCOVER, ModelStage, Record


class WhatToMake(Record):
    """What is asked of every run: ``force`` computes again what still holds, ``search`` discovers too."""

    force: bool
    search: bool


def run(request: RecalibrateRequest, work: Work) -> RecalibrateResult:
    """Recompute what is out of date."""
    return recalibrate(
        request.folders,
        force=request.again,
        search=not request.calibration_only,
        computing=Computing(request.jobs, request.scheduler, None, work.listener, work.control),
    )


def recalibrate(
    folders: Sequence[Path],
    *,
    force: bool = False,
    search: bool = True,
    computing: Computing,
) -> RecalibrateResult:
    """Calibrate and search every run in or below some folders that is out of date or was not calibrated or searched
    yet.

    A run that fails is listed and does not stop the others. Runs keep their results, so that the same command resumes.

    Raises
    ------
    InputError
        If no folder is given, or one is missing or holds no run.
    ComputingLost
        If the scheduler or all its workers are lost.
    Cancelled
        On request.
    """
    if not folders:
        raise InputError("recalibrate: give at least one folder that holds runs, such as logs")
    for folder in folders:
        check_folder(folder)
    runs = {run.absolute(): run for folder in folders for run in run_folders(folder)}
    if not runs:
        raise InputError(f"recalibrate: no runs below {', '.join(map(str, folders))}")
    tasks = {str(run): str(absolute) for absolute, run in runs.items()}
    what = partial(WhatToMake, force=force, search=search)
    gathered = gather(recalibrated_run, what, tasks, RecalibratedRun, "recalibrate", computing, all_may_fail=True)
    return RecalibrateResult(runs=tuple(gathered.found), failed=dict(gathered.failures))


def recalibrated_run(asked: WhatToMake, of: str) -> RecalibratedRun:
    """Calibrate and search one run again if needed.

    Raises
    ------
    InputError
        If the folder is not visible here, another job runs in it, or as the two verbs do.
    """
    folder, began = Path(of), time.perf_counter()
    if not folder.is_dir():
        raise InputError(
            f"{folder} is not seen on {platform.node()}: runs must lie on a file system that workers share"
        )
    if user := who_uses(folder):
        raise InputError(f"{folder} is in use ({user}); recalibrate it when that has ended")
    with RunFile.open(folder) as run:
        because = _reasons(run, asked)
    made: list[ModelStage] = []
    heldout_mm: dict[str, float] = {}
    if because:
        with RunFile.open(folder, write=True) as run:
            if CALIBRATE in because:
                heldout_mm = _calibrated_mm(calibrate_run(run, prior=_prior(run)))
                made.append("calibrate")
            if asked.search:
                found = discover_run(run)
                heldout_mm |= {
                    name: arm.heldout_position_mm.after.mean
                    for name, arm in found.arms.items()
                    if arm.heldout_position_mm is not None
                }
                made.append("discover")
    return RecalibratedRun(
        run=of,
        made=tuple(made),
        because="; ".join(f"{name}: {why}" for name, why in because.items()),
        heldout_mm=heldout_mm,
        seconds=time.perf_counter() - began,
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _reasons(run: RunFile, asked: WhatToMake) -> Mapping[str, str]:
    """Return stage -> why it must be recomputed; empty if all hold."""
    stages, reasons = read_stages(run), dict[str, str]()
    for name in (CALIBRATE, DISCOVER) if asked.search else (CALIBRATE,):
        if name not in stages.current:
            reasons[name] = "not done yet"
        elif name in stages.out_of_date:
            reasons[name] = stages.out_of_date[name]
        elif asked.force:
            reasons[name] = "asked for"
    return reasons


def _prior(run: RunFile) -> Path | None:
    """Return the earlier run that is the calibration's prior, if any. Raises ``InputError`` if there are several."""
    priors = sorted({record.run for record in recorded_priors(run).values()})
    if len(priors) > 1:
        raise InputError(f"{run.folder} rests on several earlier runs ({', '.join(priors)}); calibrate it by hand")
    return Path(priors[0]) if priors else None


def _calibrated_mm(result: CalibrateResult) -> dict[str, float]:
    """Return the mean held-out error [mm] of each arm's best model."""
    return {name: arm.validate_[arm.best_stage].position_mm.mean for name, arm in result.arms.items()}
