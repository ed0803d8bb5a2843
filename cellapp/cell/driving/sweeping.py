"""Record sweeps while a run is collected: at a measured stop each arm swings and is recorded, while the others rest, or
the other one swings too.

A simulated cell computes a sweep at once; real arms are driven and recorded through their drivers (``driven_sweep``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cellapp.cell.driving.driven_sweep import SweepDriver, SweepPart, why_no_sweeps
from cellapp.cell.driving.live_sweep import LiveSweep
from cellapp.cell.driving.step_reports import sweep_sentence
from cellapp.cell.planning.sweeps import PlannedSweep, read_sweeps, refuse_sweep
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import recording_states, store_recording
from cellapp.cell.run.recordings_csv import Key, RecordedStreams, checked_recording
from cellapp.cell.run.stream_columns import POINT, TRIGGER, pulse_column, stems
from cellapp.cell.run.stream_csv import StreamTable
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.progress import SweepLive
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.paths.sweep import Sweep
from drivers.plant.sweep import SweepRecord

CYCLE_S = 0.008
"""Time between two joint positions of a sweep [s], as sent to a simulated controller."""

Say = Callable[[str], None]


def sweeps_left(run: RunFile) -> dict[int, list[PlannedSweep]]:
    """Return the planned sweeps that are not completely recorded yet, by stop."""
    done = {(state.arm, state.part_of or state.name) for state in recording_states(run) if state.reached_s is None}
    return grouped((sweep.stop, sweep) for sweep in read_sweeps(run) if (sweep.arm, sweep.name) not in done)


class Sweeps:
    """Planned sweeps of a run that are not recorded yet. ``note`` receives warnings for a person, ``tell`` the progress
    for whoever watches, with a sentence."""

    def __init__(
        self, run: RunFile, driver: SweepDriver, session: int, note: Say, tell: Callable[[SweepLive, str], None]
    ) -> None:
        self._run, self._driver, self._note = run, driver, note
        self._tell: Callable[[SweepLive], None] = lambda live: tell(live, sweep_sentence(live))
        self._session = f"sweeps-{session}"
        self._waiting = sweeps_left(run)
        if self._waiting and driver.cell.record_sweep is None:
            why = why_no_sweeps(driver.cell, driver.interval_s)
            if why:
                note(f"sweeps are left out: {why}; record the motion with your own programs and import it")
                self._waiting = {}

    @property
    def stops(self) -> tuple[int, ...]:
        """Stops with sweeps that remain to be recorded."""
        return tuple(self._waiting)

    def at_stop(self, stop: int, at: Mapping[str, Array], checkpoint: Callable[[], None]) -> Sequence[str]:
        """Sweep every arm about the positions ``at`` where all arms rest; return the names of the recorded arms.

        ``checkpoint`` raises if a halt of the cell or a person forbids further motion. A sweep that the gate refuses is
        left out with a note. On an exception, recordings so far are stored and the other sweeps remain to be done.
        """
        recorded: list[str] = []
        waiting = self._waiting.get(stop, [])
        while waiting:
            checkpoint()
            sweep = waiting[0]
            motions = self._motions(sweep, at)
            if reason := refuse_sweep(self._driver.bodies, motions, at, self._driver.cell.gate):
                self._note(f"stop {stop + 1}: the sweep of arm {sweep.arm} is left out: {reason}")
            elif self._record(sweep, motions, at):
                recorded.append(sweep.arm)
            waiting.pop(0)
        self._waiting.pop(stop, None)
        return recorded

    def leave_out(self, stop: int, reason: str) -> None:
        """Leave out the sweeps of a stop."""
        self._note(f"stop {stop + 1}: its sweeps are left out: {reason}")
        self._waiting.pop(stop, None)

    def _motions(self, sweep: PlannedSweep, at: Mapping[str, Array]) -> dict[str, Sweep]:
        """Return the planned motions of all moving arms, slowed down during a slow start."""
        speed = self._driver.mover.speed
        planned = sweep.motions(at)
        return {name: replace(motion, period_s=motion.period_s / speed) for name, motion in planned.items()}

    def _record(self, sweep: PlannedSweep, motions: Mapping[str, Sweep], at: Mapping[str, Array]) -> bool:
        """Record one sweep about the stop ``at``; return whether anything was stored."""
        motion = motions[sweep.arm]
        begins = SweepLive(sweep.stop, sweep.arm, sweep.name, duration_s=motion.period_s)
        self._tell(begins)
        live = LiveSweep(begins, self._driver.interval_s, self._tell)
        calculated = self._driver.cell.record_sweep
        if calculated is not None:
            paths = {name: its.at(its.times(CYCLE_S)) for name, its in motions.items()}
            own = paths.pop(sweep.arm)
            found = calculated(sweep.arm, own, CYCLE_S, paths)
            beside = self._beside(sweep, at, len(found.q), next(iter(found.beside_q.values()), None))
            key = (sweep.arm, sweep.name)
            store_recording(self._run, calculated_streams(self._run.profile, key, found, beside, self._session))
            live.calculated(found)
            return True
        stored = 0
        for part in self._driver.drive(motions, self._note, live):
            beside = self._beside(sweep, at, len(part.joints.q), part.beside)
            stored += self._stored(sweep, replace(part, beside=beside))
        return stored > 0

    def _beside(self, sweep: PlannedSweep, at: Mapping[str, Array], n: int, swung: Array | None) -> Array | None:
        """Return the other arm's joint positions (n, K) [rad]; None if the other arm rests in all sweeps of the run.

        If it swings in some sweeps, its rest is given in the others: recordings of a session have the same columns.
        """
        if swung is not None or self._run.profile.plan.other_arm == "resting":
            return swung
        (resting,) = (q for name, q in at.items() if name != sweep.arm)
        return np.repeat(resting[None], n, axis=0)

    def _stored(self, sweep: PlannedSweep, part: SweepPart) -> bool:
        """Store a part of a sweep; return False, with a note, if its data are refused."""
        name = self._free_name(sweep)
        try:
            recorded = _checked(self._run.profile, (sweep.arm, name), *_columns(part), self._session)
        except InputError as error:
            self._note(f"stop {sweep.stop + 1}: a part of the sweep of arm {sweep.arm} is not kept: {error}")
            return False
        state = recorded.state.model_copy(update={"part_of": sweep.name, "reached_s": part.reached_s})
        store_recording(self._run, replace(recorded, state=state))
        if len(part.joints.triggers_s) and not len(part.track.triggers_s):
            self._note(
                f"{name} of arm {sweep.arm}: the controller gave {counted(len(part.joints.triggers_s), 'pulse')}, the"
                " tracker stamped none; look at the wiring of its trigger input"
            )
        missing = part.track.missing(self._driver.interval_s)
        if part.joints.missing or missing:
            self._note(
                f"{name} of arm {sweep.arm}: {counted(part.joints.missing, 'sample')} of the joints and"
                f" {counted(missing, 'point')} did not come"
            )
        return True

    def _free_name(self, sweep: PlannedSweep) -> str:
        """Return an unused name for the next recording of a sweep."""
        taken = {state.name for state in recording_states(self._run) if state.arm == sweep.arm}
        names = (sweep.name, *(f"{sweep.name}.{number}" for number in range(2, len(taken) + 2)))
        return next(name for name in names if name not in taken)


def calculated_streams(
    profile: Profile, key: Key, found: SweepRecord, beside: Array | None, session: str
) -> RecordedStreams:
    """Convert a sweep that a simulated cell computed into a recording of the arm and name ``key``; ``beside`` (n, K)
    [rad] are joint positions of the other arm at the joints' timestamps."""
    joints = _joint_columns(found.joint_time_s, q=found.q, qd=found.qd, other_q=beside)
    return _checked(profile, key, joints, _point_columns(found.point_time_s, found.p_M, found.sigma_m), session)


def _checked(
    profile: Profile, key: Key, joints: Mapping[str, Array], points: Mapping[str, Array], session: str
) -> RecordedStreams:
    where = Path(f"{key[1]} of arm {key[0]}")
    samples, seen = (StreamTable(where, its, {}, np.arange(len(its["time_s"]))) for its in (joints, points))
    return checked_recording(profile, key, samples, seen, session)


def _joint_columns(time_s: Array, **tables: Array | None) -> dict[str, Array]:
    """Return the columns of a stream of joints from tables (n, N) by stem; a table is None if it was not recorded."""
    columns = {"time_s": time_s}
    for stem, table in tables.items():
        if table is not None:
            columns |= dict(zip(stems("joints", table.shape[1], table.shape[1])[stem], table.T, strict=True))
    return columns


def _point_columns(time_s: Array, p_M: Array, sigma_m: Array) -> dict[str, Array]:
    """Return the columns of a stream of points (n, 3); without uncertainties if one of them is unknown."""
    columns = {"time_s": time_s, **dict(zip(POINT, p_M.T, strict=True))}
    return {**columns, "sigma_m": sigma_m} if np.isfinite(sigma_m).all() else columns


def _columns(part: SweepPart) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the columns of the joints and of the points of a part."""
    joints, track = part.joints, part.track
    samples = _joint_columns(
        joints.time_s,
        q=joints.q,
        qd=joints.qd,
        joint_temperature=joints.temperature_c,
        other_q=part.beside,
    )
    points = _point_columns(track.device_time_s, track.p_M, track.sigma_m)
    for its, stamps_s in ((samples, joints.triggers_s), (points, track.triggers_s)):
        if len(stamps_s) and len(its["time_s"]) > len(stamps_s):
            its[TRIGGER] = pulse_column(its["time_s"], stamps_s)
    return samples, points
