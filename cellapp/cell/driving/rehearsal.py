"""Rehearse a plan without the tracker: first only the controllers, then real arms, in steps of increasing risk."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from cellapp.cell.driving.cell import open_arms
from cellapp.cell.driving.cell_checks import check_controllers
from cellapp.cell.driving.motion import Confirm, MotionRefused, Mover
from cellapp.cell.driving.records import RehearsedMotion, RehearseResult
from cellapp.cell.driving.rehearsal_rungs import RUNGS, Rung, RungName
from cellapp.cell.driving.stops_to_collect import StopsToCollect, Travel, remaining_work
from cellapp.cell.driving.supervision import reacting
from cellapp.cell.run import RunFile
from cellapp.cell.run.run_arms import recorded_controllers
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError
from cellapp.ground.progress import Detail, MotionBegun, MotionEnded
from cellapp.robot.kinematics.transforms import Array


def rehearse(
    run: RunFile, name: RungName, arms: tuple[str, ...], control: JobControl, confirm: Confirm | None
) -> RehearseResult:
    """Drive the planned stops of a run for one rung with ``arms``; the others stay where they are. Store nothing.

    Refusals by a device, and a fault that ends the rung, are in the result.

    Raises
    ------
    InputError
        Without a plan, if the first motion is not confirmed, or if a record of the run is damaged.
    Stopped, Aborted
        If a person stopped it; the arms have been braked.
    """
    driver, notes, ended = _Driver(remaining_work(run, resume=True), RUNGS[name], arms), tuple[str, ...](), ""
    try:
        simulation = driver.rung.simulation
        with open_arms(run.profile, control, simulation=simulation) as cell, reacting(cell, control) as reaction:
            notes = check_controllers(run, cell)
            driver.drive(Mover(run.profile, cell, cell_bodies(run.profile), reaction, control), confirm)
    except (HardwareError, MotionRefused) as error:
        ended = str(error)
    return RehearseResult(
        rung=name,
        arms=arms,
        when=datetime.now(UTC).isoformat(timespec="seconds"),
        controllers={
            arm: f"{its.model} {its.serial}, {its.software}" for arm, its in recorded_controllers(run).items()
        },
        visited=tuple(driver.visited),
        refused=dict(sorted(driver.refused.items())),
        motions=tuple(driver.motions),
        notes=notes,
        ended=ended,
    )


@dataclass
class _Driver:
    """Drives one rung in an open cell; ``visited`` and ``refused`` are stops, counted from 1."""

    work: StopsToCollect
    rung: Rung
    arms: tuple[str, ...]
    visited: list[int] = field(default_factory=list)
    refused: dict[int, str] = field(default_factory=dict)
    motions: list[RehearsedMotion] = field(default_factory=list)
    _begun: tuple[MotionBegun, float] | None = None

    def drive(self, mover: Mover, confirm: Confirm | None) -> None:
        """Visit the stops of the rung, then go home."""
        self.mover, self.travel = mover, Travel(mover, self.work)
        mover.emit, mover.speed = self._note, self.rung.share
        forbidden = self.travel.forbidden_stops()
        stops = [stop for stop in self.work.stops if stop not in forbidden][: self.rung.stops]
        if self.rung.stops is None:
            self.refused |= {stop + 1: why for stop, why in forbidden.items()}
        if stops:
            mover.confirm_first(self._targets(stops[0]), confirm)
        for number, stop in enumerate(stops):
            mover.hold()
            mover.control.tell("rehearse", number, len(stops), f"stop {stop + 1}")
            mover.stop = stop
            try:
                self._to_stop(stop)
                self.visited.append(stop + 1)
            except MotionRefused as error:
                self.refused[stop + 1] = str(error)
            finally:
                mover.stop = None
        mover.go_home(self.arms)
        mover.control.tell("rehearse", len(stops), len(stops), "done")

    def _to_stop(self, stop: int) -> None:
        """Move as collecting does; if only some arms of the cell move, go straight or from home."""
        if set(self.arms) == set(self.work.route.q):
            self.travel.to_stop(stop)
            return
        try:
            self.mover.move(self._targets(stop))
        except MotionRefused:
            self.mover.go_home(self.arms)
            self.mover.move(self._targets(stop))

    def _targets(self, stop: int) -> dict[str, Array]:
        return {name: q for name, q in self.work.route.targets(stop).items() if name in self.arms}

    def _note(self, detail: Detail) -> None:
        """Record duration and deviation of a motion from the reports of its beginning and end."""
        now_s = self.mover.cell.clock.now_s()
        if isinstance(detail, MotionBegun):
            self._begun = detail, now_s
        elif isinstance(detail, MotionEnded) and self._begun is not None:
            begun, since_s = self._begun
            off_mrad = {
                name: 1e3 * float(np.abs(np.array(q) - detail.q[name]).max(initial=0.0))
                for name, q in begun.q_target.items()
                if name in detail.q
            }
            expected_s = begun.expected_s if math.isfinite(begun.expected_s) else 0.0
            stop = None if begun.stop is None else begun.stop + 1
            self.motions.append(
                RehearsedMotion(stop=stop, seconds=now_s - since_s, expected_s=expected_s, off_mrad=off_mrad)
            )
            self._begun = None
