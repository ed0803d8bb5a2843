"""The verb: drive the planned stops, measure both SMRs at each, and commit every stop before the next move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np

from cellapp.collection.cell import open_cell
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


def collect_run(
    run: RunFile,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    *,
    resume: bool = False,
    watch_clearance: bool = False,
) -> tuple[str, ...]:
    """Collect what is planned and not yet stored. Returns notes for the person.

    A target that cannot be measured is noted and its arm's reading left out; the stop counts as done for the other
    arm. A stop that discovery proposed is approached and waited for as it asks, and left out with a note if the gate
    refuses it; once splits are drawn its readings are for training, so that what validates stays what it was. Cancelled
    between stops, or while the arms wait, they rest and the run can be resumed.

    Raises
    ------
    InputError
        If there is no plan, or stops are stored and ``resume`` was not asked for.
    HardwareError
        If an arm or the tracker fails; what was committed stays.
    Cancelled
    """
    cancel = cancel or CancelToken()
    profile = run.profile
    plan = run.read_plan()
    if not plan:
        raise InputError(f"{run.path}: there is no plan; make one with 'cellapp plan'")
    done = run.stops_done()
    if done and not resume:
        raise InputError(f"{run.path}: {len(done)} stops are stored already; go on with --resume, or start a new run")
    total = len(next(iter(plan.values())))
    left = [stop for stop in range(total) if stop not in done]
    if not left:
        return (f"all {total} stops were stored already",)
    notes: list[str] = []
    proposed = read_stop_conditions(run)
    drawn = bool(proposed) and any(run.readings(name).split is not None for name in run.arms())
    bodies = cell_bodies(profile)
    earlier = max((float(run.readings(name).time_s.max()) for name in run.arms()), default=0.0) if done else 0.0
    with open_cell(profile, watch_clearance=watch_clearance) as cell:
        notes += check_controllers(run, cell)
        mover = Mover(profile, cell, bodies)
        air = None if cell.air is None else _Air(cell.air, run, notes)
        began: float | None = None
        missed = 0
        for place, stop in enumerate(left):
            cancel.check()
            listener(Progress("collect", total - len(left) + place, total, f"stop {stop + 1}"))
            targets = {name: rows[stop] for name, rows in plan.items()}
            factors = proposed.get(stop, {})
            try:
                states = _go_as_proposed(mover, targets, factors) if stop in proposed else _go(mover, targets)
            except MotionRefused as error:
                if stop not in proposed:
                    raise
                note = f"stop {stop + 1}: left out: {error}"
                run.log("warning", note)
                notes.append(note)
                continue
            air_c = None if air is None else air.temperature_c(stop)
            rows: dict[str, Reading] = {}
            for name in sorted(states, key=lambda name: _dwell_s(factors, name)):  # who waits longest comes last
                state = states[name]
                if _dwell_s(factors, name) > 0.0:
                    mover.rest(name, _dwell_s(factors, name), cancel)
                try:
                    point = mover.measure(name, state.q)
                except TrackerError as error:
                    note = f"stop {stop + 1}, arm {name}: not measured: {error}"
                    run.log("warning", note)
                    notes.append(note)
                    continue
                if began is None:  # by the tracker's clock alone: controllers have their own
                    began = point.time_s - point.averaging_s - earlier
                temperature_c = point.temperature_c if air is None else air_c
                split = "train" if drawn and stop in proposed else None
                rows[name] = _reading(state, point, mover, name, began, temperature_c, split)
            missed = 0 if rows else missed + 1
            if missed >= _MOST_MISSED_IN_A_ROW:
                raise HardwareError(f"the tracker saw no SMR at {missed} stops in a row; look at tracker and targets")
            if rows:
                run.add_stop(stop, rows)
        listener(Progress("collect", total, total, "going home"))
        try:
            mover.move(home_positions(profile))
        except MotionRefused as error:
            notes.append(f"the arms stay where they are: {error}")
        if cell.plant is not None and cell.plant.clearance is not None:
            notes.append(f"smallest distance between the arms {cell.plant.clearance.arms_m * 1e3:.0f} mm")
    return tuple(notes)


def _go(mover: Mover, targets: dict[str, np.ndarray]) -> dict[str, ArmState]:
    """Move straight, or by way of home where the straight way is refused (after a resume, or a missed stop)."""
    try:
        return mover.move(targets)
    except MotionRefused:
        mover.go_home()
        return mover.move(targets)


def _go_as_proposed(
    mover: Mover, targets: dict[str, np.ndarray], factors: Mapping[str, StopConditions]
) -> dict[str, ArmState]:
    """Move to where the last legs begin, all arms at once or one after the other, then those legs.

    Nothing moves unless the gate lets the arms do all of it; where it does not, they go home and try from there.
    """
    vias = {name: one.via for name, one in factors.items() if one.via is not None and name in targets}
    start, last = {**targets, **vias}, {name: targets[name] for name in vias}
    orders = [[start], *([{name: start[name]} for name in order] for order in permutations(start))]
    ways = [[*legs, last] if last else legs for legs in orders]
    for at_home in (False, True):
        if at_home:
            mover.go_home()
        for legs in ways:
            if not mover.refusal(*legs):
                states: dict[str, ArmState] = {}
                for leg in legs:
                    states |= mover.move(leg)
                return states
    raise MotionRefused(f"refused to move: {mover.refusal(*ways[0])}")


def _dwell_s(factors: Mapping[str, StopConditions], name: str) -> float:
    return factors[name].dwell_s if name in factors else 0.0


@dataclass
class _Air:
    """The weather station: its temperature goes with the readings, and none where it fails; that is noted once.

    The tracker's own air temperature does not stand in: a change of thermometer would look like a change of the air.
    """

    sensor: AirSensor
    run: RunFile
    notes: list[str]
    state: Literal["new", "well", "failed"] = "new"

    def temperature_c(self, stop: int) -> float | None:
        try:
            reading = self.sensor.read()
        except SensorError as error:
            if self.state != "failed":
                note = f"stop {stop + 1}: readings go without air temperature: {error}"
                self.run.log("warning", note)
                self.notes.append(note)
            self.state = "failed"
            return None
        if self.state != "well":
            self.run.log("info", f"stop {stop + 1}: {reading}")
        self.state = "well"
        return reading.temperature_c


def _reading(
    state: ArmState,
    point: Point,
    mover: Mover,
    name: str,
    began: float,
    temperature_c: float | None,
    split: str | None,
) -> Reading:
    """The reading of a point that was taken just now; its dwell is to the middle of the averaging."""
    rested = mover.rested_s(name)
    return Reading(
        q=state.q,
        p_M=point.p_M,
        time_s=point.time_s - began,
        approach=mover.approach(name).copy(),
        payload_kg=state.payload_kg,
        temperature_c=temperature_c,
        joint_temperature_c=state.joint_temperature_c,
        step=mover.step(name),
        dwell_s=None if rested is None else max(rested - 0.5 * point.averaging_s, 0.0),
        covariance_M=point.covariance_M,
        split=split,
    )
