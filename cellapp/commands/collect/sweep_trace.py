"""Trace of the sweep recorded last: the speed of its SMR as seen by the tracker."""

from __future__ import annotations

import numpy as np

from cellapp.cell.driving.records import SweepTrace
from cellapp.cell.planning.sweeps import read_sweeps
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import read_stream, recording_states
from cellapp.cell.run.stream_columns import POINT

_MOST_DRAWN = 300
_GAP = 3.0
"""Ratio of the time between two drawn points to the usual one from which the beam was lost between them."""


def last_sweep(run: RunFile) -> SweepTrace | None:
    """Return the trace of the sweep recorded last; None if none was planned or recorded."""
    places = {(sweep.arm, sweep.name): place for place, sweep in enumerate(read_sweeps(run))}
    found = [
        (places[key], state)
        for state in recording_states(run)
        if (key := (state.arm, state.part_of or state.name)) in places
    ]
    if not found:
        return None
    _, newest = max(found, key=lambda one: (one[0], one[1].name))
    columns, _ = read_stream(run, newest, "points")
    time_s, p_M = columns["time_s"], np.column_stack([columns[name] for name in POINT])
    rows = np.linspace(0, len(time_s) - 1, min(len(time_s), _MOST_DRAWN)).astype(np.intp)
    step_s = np.diff(time_s[rows])
    speed = 1e3 * np.linalg.norm(np.diff(p_M[rows], axis=0), axis=1) / np.maximum(step_s, 1e-9)
    seen = step_s < _GAP * float(np.median(step_s))
    return SweepTrace(
        arm=newest.arm,
        name=newest.name,
        recorded=len({place for place, _ in found}),
        planned=len(places),
        lost=newest.points.lost,
        time_s=tuple((0.5 * (time_s[rows][1:] + time_s[rows][:-1]) - time_s[0]).round(3).tolist()),
        speed_mm_s=tuple(
            one if there else None for one, there in zip(speed.round(2).tolist(), seen.tolist(), strict=True)
        ),
    )
