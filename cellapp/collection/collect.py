"""The verb: drive the planned stops, measure both SMRs at each, and commit every stop before the next motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import permutations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.collection.cell import Cell, open_cell
from cellapp.collection.controllers import check_controllers
from cellapp.collection.motion import MotionRefused, Mover
from cellapp.errors import HardwareError, InputError
from cellapp.planning.stop_conditions import StopConditions, read_stop_conditions
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import Reading, RunFile
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from drivers.arms.protocol import ArmState
from drivers.sensors.protocol import AirSensor, SensorError
from drivers.trackers.protocol import Point, TrackerError

_MOST_MISSED_IN_A_ROW = 10
"""The plan has visible stops only: this many misses in a row are a fault of the tracker or of the targets."""
_NO_FACTORS = StopConditions()
"""Straight approach, no dwell."""

Targets = Mapping[str, NDArray[np.float64]]
"""Arm -> joint positions (N,) [rad]."""


def collect_run(
    run: RunFile,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    *,
    resume: bool = False,
    watch_clearance: bool = False,
) -> tuple[str, ...]:
    """Collect all planned stops that are not stored yet. Returns notes for the person.

    A target that cannot be measured is noted and its arm's reading left out; the stop counts as done for the other
    arm. A stop that discovery proposed has its own approach and dwell; if the gate refuses it, it is left out with a
    note. Once splits are drawn, its readings are for training: the validation set must not change. A job cancelled
    between stops, or while the arms wait, leaves them at rest, and the run can be resumed.

    Raises
    ------
    InputError
        If there is no plan, or stops are stored and ``resume`` is False.
    HardwareError
        If an arm or the tracker fails; all committed stops stay.
    Cancelled
    """
    cancel = cancel or CancelToken()
    work = _remaining_work(run, resume=resume)
    if not work.stops:
        return (f"all {work.total} stops were stored already",)
    bodies = cell_bodies(run.profile)
    with open_cell(run.profile, watch_clearance=watch_clearance) as cell:
        notes = list(check_controllers(run, cell).notes)
        session = _Session(run, work, cell, Mover(run.profile, cell, bodies), cancel, notes)
        missed = 0
        for index, stop in enumerate(work.stops):
            cancel.check()
            listener(Progress("collect", work.total - len(work.stops) + index, work.total, f"stop {stop + 1}"))
            states = session.approach(stop)
            if states is None:
                continue
            rows = session.measure(stop, states)
            missed = 0 if rows else missed + 1
            if missed >= _MOST_MISSED_IN_A_ROW:
                raise HardwareError(f"the tracker saw no SMR at {missed} stops in a row; check tracker and targets")
            if rows:
                run.add_stop(stop, rows)
        listener(Progress("collect", work.total, work.total, "going home"))
        session.end()
        return tuple(session.notes)


@dataclass(frozen=True)
class _Work:
    """The stops to collect.

    Attributes
    ----------
    plan : mapping
        Arm -> joint positions of all stops (n, N) [rad].
    total : int
        Number of planned stops, including those that are stored.
    stops : tuple of int
        Numbers of the stops that are not stored.
    proposed : mapping
        Stop -> arm -> approach and dwell, for stops that discovery proposed.
    split : str or None
        Split of readings at proposed stops; None if splits are not drawn yet.
    earlier_s : float
        Time of the last stored reading [s]; new readings follow it.
    """

    plan: Mapping[str, NDArray[np.float64]]
    total: int
    stops: tuple[int, ...]
    proposed: Mapping[int, Mapping[str, StopConditions]]
    split: str | None
    earlier_s: float

    def targets(self, stop: int) -> dict[str, NDArray[np.float64]]:
        """Return the joint positions of a stop by arm."""
        return {name: q[stop] for name, q in self.plan.items()}

    def factors(self, stop: int, name: str) -> StopConditions:
        """Return approach and dwell of an arm at a stop."""
        return self.proposed.get(stop, {}).get(name, _NO_FACTORS)


def _remaining_work(run: RunFile, *, resume: bool) -> _Work:
    plan = run.read_plan()
    if not plan:
        raise InputError(f"{run.path}: there is no plan; make one with 'cellapp plan'")
    done = run.stops_done()
    if done and not resume:
        raise InputError(
            f"{run.path}: {len(done)} stops are stored already; continue with --resume, or start a new run"
        )
    total = len(next(iter(plan.values())))
    readings = [run.readings(name) for name in run.arms()]
    proposed = read_stop_conditions(run)
    drawn = bool(proposed) and any(arm.split is not None for arm in readings)
    return _Work(
        plan=plan,
        total=total,
        stops=tuple(stop for stop in range(total) if stop not in done),
        proposed=proposed,
        split="train" if drawn else None,
        earlier_s=max((float(arm.time_s.max()) for arm in readings), default=0.0) if done else 0.0,
    )


@dataclass
class _Session:
    """One open cell while its stops are collected."""

    run: RunFile
    work: _Work
    cell: Cell
    mover: Mover
    cancel: CancelToken
    notes: list[str]
    began_s: float | None = None
    """Start of the run on the tracker's clock [s]. Controllers have clocks of their own, which are not used."""
    air: _AirTemperature | None = field(init=False)

    def __post_init__(self) -> None:
        self.air = None if self.cell.air is None else _AirTemperature(self.cell.air, self.run, self.notes)

    def approach(self, stop: int) -> dict[str, ArmState] | None:
        """Move to a stop; None, with a note, if the gate refuses a proposed one."""
        targets = self.work.targets(stop)
        if stop not in self.work.proposed:
            return _move(self.mover, targets)
        try:
            return _move_as_proposed(self.mover, targets, self.work.proposed[stop])
        except MotionRefused as error:
            self._note(f"stop {stop + 1}: left out: {error}")
            return None

    def measure(self, stop: int, states: Mapping[str, ArmState]) -> dict[str, Reading]:
        """Measure the arms in the order of their dwell times. An SMR that cannot be measured is noted."""
        temperature_c = None if self.air is None else self.air.at_stop(stop)
        rows: dict[str, Reading] = {}
        dwell_s = {name: self.work.factors(stop, name).dwell_s for name in states}
        for name in sorted(states, key=lambda name: dwell_s[name]):
            if dwell_s[name] > 0.0:
                self.mover.rest(name, dwell_s[name], self.cancel)
            try:
                point = self.mover.measure(name, states[name].q)
            except TrackerError as error:
                self._note(f"stop {stop + 1}, arm {name}: not measured: {error}")
                continue
            air_c = point.temperature_c if self.air is None else temperature_c
            rows[name] = self._reading(stop, name, states[name], point, air_c)
        return rows

    def end(self) -> None:
        """Move all arms home, and note the smallest distance between them if it was observed."""
        try:
            self.mover.move(home_positions(self.run.profile))
        except MotionRefused as error:
            self.notes.append(f"the arms stay where they are: {error}")
        if self.cell.clearance is not None:
            self.notes.append(f"smallest distance between the arms {self.cell.clearance.arms_m * 1e3:.0f} mm")

    def _note(self, text: str) -> None:
        self.run.log("warning", text)
        self.notes.append(text)

    def _reading(self, stop: int, name: str, state: ArmState, point: Point, temperature_c: float | None) -> Reading:
        """Return the reading of a point that was just measured; its dwell ends at the middle of the averaging."""
        if self.began_s is None:
            self.began_s = point.time_s - point.averaging_s - self.work.earlier_s
        rested_s = self.mover.rested_s(name)
        return Reading(
            q=state.q,
            p_M=point.p_M,
            time_s=point.time_s - self.began_s,
            approach=self.mover.approach(name).copy(),
            payload_kg=state.payload_kg,
            temperature_c=temperature_c,
            joint_temperature_c=state.joint_temperature_c,
            step=self.mover.step(name),
            dwell_s=None if rested_s is None else max(rested_s - 0.5 * point.averaging_s, 0.0),
            covariance_M=point.covariance_M,
            split=self.work.split if stop in self.work.proposed else None,
        )


@dataclass
class _AirTemperature:
    """Air temperature from the weather station; None while it fails, which is noted once.

    The tracker's own sensor is no substitute: a change of sensor would look like a change of the air.
    """

    sensor: AirSensor
    run: RunFile
    notes: list[str]
    state: Literal["new", "working", "failed"] = "new"

    def at_stop(self, stop: int) -> float | None:
        """Read the air temperature [degC]."""
        try:
            reading = self.sensor.read()
        except SensorError as error:
            if self.state != "failed":
                note = f"stop {stop + 1}: readings go without air temperature: {error}"
                self.run.log("warning", note)
                self.notes.append(note)
            self.state = "failed"
            return None
        if self.state != "working":
            self.run.log("info", f"stop {stop + 1}: {reading}")
        self.state = "working"
        return reading.temperature_c


def _move(mover: Mover, targets: Targets) -> dict[str, ArmState]:
    """Move straight, or via home if the gate refuses that (after a resume, or a missed stop)."""
    try:
        return mover.move(targets)
    except MotionRefused:
        mover.go_home()
        return mover.move(targets)


def _move_as_proposed(mover: Mover, targets: Targets, factors: Mapping[str, StopConditions]) -> dict[str, ArmState]:
    """Move to where the last legs begin, all arms at once or one after the other, then do those legs.

    Nothing moves unless the gate accepts all legs. If it does not, the arms go home and try from there.
    """
    vias = {name: one.via for name, one in factors.items() if one.via is not None and name in targets}
    start, last = {**targets, **vias}, {name: targets[name] for name in vias}
    orders: list[list[Targets]] = [[start]]
    orders += [[{name: start[name]} for name in order] for order in permutations(start)]
    routes = [[*legs, last] if last else legs for legs in orders]
    for at_home in (False, True):
        if at_home:
            mover.go_home()
        for legs in routes:
            if not mover.refusal(*legs):
                states: dict[str, ArmState] = {}
                for leg in legs:
                    states |= mover.move(leg)
                return states
    raise MotionRefused(f"refused to move: {mover.refusal(*routes[0])}")
