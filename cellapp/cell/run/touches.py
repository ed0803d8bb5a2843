"""Touches of sockets that are recorded into a run one by one."""

from __future__ import annotations

import time
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from cellapp.cell.run.distances import DISTANCES_RESULT, distances_text, read_distances_csv
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.measured_again import withdraw_reading
from cellapp.cell.run.sqlite_file import FILE_NAME
from cellapp.estimation.readings import Reading, Readings
from cellapp.estimation.sockets import in_sockets
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile


def touches_before(folder: Path, profile: Profile, arm: str) -> Readings | None:
    """Return the touches of an arm in a run; None if there are none, or no run yet.

    Raises
    ------
    InputError
        If the run is of another profile, or is one of a tracker.
    """
    if not (folder / FILE_NAME).exists():
        return None
    with RunFile.open(folder) as run:
        if run.profile != profile:
            raise InputError(
                f"{run.path}: the run was begun with another profile than this one; give the profile that it was begun"
                " with ('cellapp show RUN profile'), or another folder with --run"
            )
        if run.planned_counts():
            raise InputError(
                f"{run.path}: the run has a plan for a tracker; touches of sockets need a run of their own: give"
                " another folder with --run"
            )
        for name in run.arms():
            if not in_sockets(run.rows(name)):
                raise InputError(
                    f"{run.path}: the run holds readings of a tracker (arm {name}); touches of sockets need a run of"
                    " their own: give another folder with --run"
                )
        return run.rows(arm) if arm in run.arms() else None


def store_touch(folder: Path, profile: Profile, arm: str, touch: Reading) -> int:
    """Append a touch to a run, which is made if missing; return its configuration. On return it is on disk."""
    if (folder / FILE_NAME).exists():
        with RunFile.open(folder, write=True) as run:
            return _append(run, arm, touch)
    number: list[int] = []
    RunFile.create(folder, profile, lambda run: number.append(_append(run, arm, touch))).close()
    return number[0]


def _append(run: RunFile, arm: str, touch: Reading) -> int:
    """Append a touch after all others, with its time since the run was made."""
    number = max(run.stops_done(), default=-1) + 1
    since_s = time.time() - datetime.fromisoformat(run.created).timestamp()
    run.add_stop(number, {arm: replace(touch, time_s=max(since_s, 0.0))})
    run.log("info", f"arm {arm}: touched '{touch.point}' (configuration {number})")
    return number


def withdraw_last_touch(folder: Path, profile: Profile, arm: str) -> tuple[str, int]:
    """Take back the last touch of an arm; return its point and configuration.

    It is kept with the readings that were replaced. Raises ``InputError`` if there is none.
    """
    before = touches_before(folder, profile, arm)
    if before is None:
        raise InputError(f"{folder}: there is no touch of arm {arm} to take back")
    last = int(np.argmax(before.configuration))
    number, point = int(before.configuration[last]), str((before.point or ())[last])
    with RunFile.open(folder, write=True) as run:
        withdraw_reading(run, number, arm)
        run.log("info", f"arm {arm}: the touch of '{point}' (configuration {number}) was taken back")
    return point, number


def store_distances(folder: Path, distances: Path) -> None:
    """Check the known distances between sockets in a file against the touches of a run, and store them.

    Raises ``InputError`` as ``read_distances_csv``.
    """
    with RunFile.open(folder, write=True) as run:
        readings = read_distances_csv(distances, run.profile, {arm: run.rows(arm) for arm in run.arms()})
        run.write_result(DISTANCES_RESULT, distances_text(readings))
