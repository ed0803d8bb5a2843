"""Small stored runs for lists: planned, collected in part, interrupted; made in milliseconds, without devices."""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

import numpy as np

from cellapp.cell.run import RunFile, SessionEnd
from cellapp.estimation.readings import Reading
from cellapp.ground.profile import Profile
from tests.cell.run.two_arm_cell import two_arms


def planned_run(folder: Path, stops: int = 4, profile: Profile | None = None) -> RunFile:
    """A run with a plan for both arms; it is open for writing."""
    run = RunFile.create(folder, profile or two_arms())
    run.write_plan({"left": np.arange(2.0 * stops).reshape(stops, 2), "right": np.zeros((stops, 3))})
    return run


def add_stop(run: RunFile, stop: int) -> None:
    """A stop of both arms."""
    run.add_stop(
        stop,
        {
            name: Reading(q=np.full(len(arm.type.joints), float(stop)), p_M=np.ones(3), time_s=float(stop))
            for name, arm in run.profile.arms.items()
        },
    )


def collected_run(folder: Path, outcome: SessionEnd | None, measured: int = 2, stops: int = 4) -> Path:
    """A run with one session that measured some of the stops; None: the program died in it."""
    with planned_run(folder, stops) as run:
        session = run.begin_session()
        for stop in range(measured):
            add_stop(run, stop)
        if outcome is not None:
            run.end_session(session, outcome, "")
    return folder


def set_began(folder: Path, minute: int) -> None:
    """Let a run have begun in a minute of some hour: runs made in the same millisecond have no order."""
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as connection:
        began = f"2026-01-02T03:{minute:02}:00.000+00:00"
        connection.execute("UPDATE meta SET value = ? WHERE key = 'created'", (began,))
        connection.commit()
