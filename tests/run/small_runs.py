"""Small stored runs for lists: planned, collected in part, interrupted; made in milliseconds, without devices."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellapp.profile import Profile
from cellapp.run import Reading, RunFile, SessionEnd
from tests.run.two_arm_cell import two_arms


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
