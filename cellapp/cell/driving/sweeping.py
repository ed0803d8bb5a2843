"""Sweeps while a run is collected: at a stop that was measured each arm swings and is recorded, the others resting."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from cellapp.cell.driving.cell import Cell
from cellapp.cell.planning.sweeps import PlannedSweep, read_sweeps, refuse_sweep
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import recording_states, store_recording
from cellapp.cell.run.recordings_csv import RecordedStreams, checked_recording
from cellapp.cell.run.stream_columns import POINT
from cellapp.cell.run.stream_csv import StreamTable
from cellapp.cell.safety.gate import CellBodies
from cellapp.ground.grouping import grouped
from cellapp.robot.kinematics.transforms import Array
from drivers.plant.sweep import SweepRecord

CYCLE_S = 0.008
"""Time between two joint positions of a sweep that a controller is given [s]."""


class Sweeps:
    """The planned sweeps of a run that are not recorded yet."""

    def __init__(self, run: RunFile, cell: Cell, bodies: CellBodies, session: int, note: Callable[[str], None]) -> None:
        self._run, self._cell, self._bodies, self._note = run, cell, bodies, note
        self._session = f"sweeps-{session}"
        done = {(state.arm, state.name) for state in recording_states(run)}
        self._waiting = grouped(
            (sweep.stop, sweep) for sweep in read_sweeps(run) if (sweep.arm, sweep.name) not in done
        )
        if self._waiting and cell.record_sweep is None:
            note("sweeps are recorded on simulated cells only; record the motion with your own programs and import it")
            self._waiting = {}

    def at_stop(self, stop: int, at: Mapping[str, Array], checkpoint: Callable[[], None]) -> Sequence[str]:
        """Sweep every arm about the joint positions ``at`` which all arms rest; names of the arms that were recorded.

        ``checkpoint`` raises where a stop of the cell or a person forbids further motion. A sweep that the gate refuses
        is left out with a note.
        """
        recorded = []
        for sweep in self._waiting.pop(stop, []):
            checkpoint()
            motion = sweep.motion(at[sweep.arm])
            others = {name: q for name, q in at.items() if name != sweep.arm}
            if reason := refuse_sweep(self._bodies, sweep.arm, motion, others, self._cell.gate):
                self._note(f"stop {stop + 1}: the sweep of arm {sweep.arm} is left out: {reason}")
                continue
            assert self._cell.record_sweep is not None
            record = self._cell.record_sweep(sweep.arm, motion.at(motion.times(CYCLE_S)), CYCLE_S)
            store_recording(self._run, self._streams(sweep, record))
            recorded.append(sweep.arm)
        return recorded

    def _streams(self, sweep: PlannedSweep, record: SweepRecord) -> RecordedStreams:
        joints = record.q.shape[1]
        columns = {"time_s": record.joint_time_s}
        columns |= {f"q{j + 1}": record.q[:, j] for j in range(joints)}
        columns |= {f"qd{j + 1}": record.qd[:, j] for j in range(joints)}
        points = {
            "time_s": record.point_time_s,
            **dict(zip(POINT, record.p_M.T, strict=True)),
            "sigma_m": record.sigma_m,
        }
        where = Path(f"{sweep.name} of arm {sweep.arm}")
        samples, seen = (StreamTable(where, its, {}, np.arange(len(its["time_s"]))) for its in (columns, points))
        return checked_recording(self._run.profile, (sweep.arm, sweep.name), samples, seen, self._session)
